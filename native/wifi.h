// One server's wireless network: an ad-hoc WiFi channel of its own, and the stations on it.
#pragma once

#include <ns3/mobility-model.h>
#include <ns3/node.h>
#include <ns3/wifi-net-device.h>
#include <ns3/yans-wifi-channel.h>

#include <istream>
#include <string>

struct RadioSettings
{
    std::string standard;    // 802.11a or 802.11g
    std::string dataMode;    // constant, such as OfdmRate18Mbps
    std::string controlMode; // of acknowledgements
    double lossAt1mDb;       // log-distance path loss: so much at 1 m,
    double lossExponent;     // and 10 times this more for every tenfold distance
};

std::istream& operator>>(std::istream& words, RadioSettings& settings);

ns3::Ptr<ns3::YansWifiChannel> MakeAir(const RadioSettings& settings);

// A station of the channel on a node of its own, at a position in metres.
ns3::Ptr<ns3::WifiNetDevice> MakeStation(ns3::Ptr<ns3::YansWifiChannel> air,
                                         const RadioSettings& settings,
                                         double eastM,
                                         double northM);

void MoveStation(ns3::Ptr<ns3::WifiNetDevice> station, double eastM, double northM);
