#include "wifi.h"

#include <ns3/boolean.h>
#include <ns3/constant-position-mobility-model.h>
#include <ns3/double.h>
#include <ns3/string.h>
#include <ns3/wifi-helper.h>
#include <ns3/wifi-mac-helper.h>
#include <ns3/yans-wifi-helper.h>

#include <stdexcept>

using namespace ns3;

std::istream&
operator>>(std::istream& words, RadioSettings& settings)
{
    return words >> settings.standard >> settings.dataMode >> settings.controlMode >> settings.lossAt1mDb >>
           settings.lossExponent;
}

static WifiStandard
StandardOf(const RadioSettings& settings)
{
    if (settings.standard == "802.11a")
        return WIFI_STANDARD_80211a;
    if (settings.standard == "802.11g")
        return WIFI_STANDARD_80211g;
    throw std::invalid_argument("unknown standard " + settings.standard);
}

Ptr<YansWifiChannel>
MakeAir(const RadioSettings& settings)
{
    YansWifiChannelHelper air;
    air.SetPropagationDelay("ns3::ConstantSpeedPropagationDelayModel");
    air.AddPropagationLoss("ns3::LogDistancePropagationLossModel",
                           "ReferenceLoss",
                           DoubleValue(settings.lossAt1mDb),
                           "Exponent",
                           DoubleValue(settings.lossExponent));
    return air.Create();
}

Ptr<WifiNetDevice>
MakeStation(Ptr<YansWifiChannel> air, const RadioSettings& settings, double eastM, double northM)
{
    Ptr<Node> node = CreateObject<Node>();
    node->AggregateObject(CreateObject<ConstantPositionMobilityModel>());
    WifiHelper wifi;
    wifi.SetStandard(StandardOf(settings));
    wifi.SetRemoteStationManager("ns3::ConstantRateWifiManager",
                                 "DataMode",
                                 StringValue(settings.dataMode),
                                 "ControlMode",
                                 StringValue(settings.controlMode));
    WifiMacHelper mac;
    mac.SetType("ns3::AdhocWifiMac");
    YansWifiPhyHelper phy;
    phy.SetChannel(air);
    auto station = DynamicCast<WifiNetDevice>(wifi.Install(phy, mac, node).Get(0));
    MoveStation(station, eastM, northM);
    return station;
}

void
MoveStation(Ptr<WifiNetDevice> station, double eastM, double northM)
{
    station->GetNode()->GetObject<MobilityModel>()->SetPosition(Vector(eastM, northM, 0.0));
}
