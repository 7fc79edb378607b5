// How long a transfer takes over a simulated WiFi channel: a drone that hovers at a distance sends a server a request.
//
//     goodput STANDARD DATA_MODE CONTROL_MODE LOSS_AT_1M_DB LOSS_EXPONENT DISTANCE_M REQUEST_BYTES FIRST_SEED RUNS
//
// Prints a line for each run: the seconds from the first byte written to the last one read, and those until a short
// answer is back; `inf inf` where it was not through within a minute.

#include "wifi.h"

#include <ns3/config.h>
#include <ns3/internet-stack-helper.h>
#include <ns3/ipv4-address-helper.h>
#include <ns3/net-device-container.h>
#include <ns3/rng-seed-manager.h>
#include <ns3/simulator.h>
#include <ns3/socket.h>
#include <ns3/tcp-socket-factory.h>
#include <ns3/uinteger.h>

#include <cmath>
#include <iostream>
#include <sstream>

using namespace ns3;

static const uint16_t PORT = 7070;
static const uint32_t ANSWER_BYTES = 500;

// One request over an open connection, and the answer to it.
class Transfer
{
  public:
    Transfer(Ptr<Node> drone, Ptr<Node> server, Ipv4Address serverAddress, uint32_t bytes)
        : m_unsent(bytes),
          m_missing(bytes),
          m_unanswered(ANSWER_BYTES)
    {
        m_listening = Socket::CreateSocket(server, TcpSocketFactory::GetTypeId());
        m_listening->Bind(InetSocketAddress(Ipv4Address::GetAny(), PORT));
        m_listening->Listen();
        m_listening->SetAcceptCallback(MakeNullCallback<bool, Ptr<Socket>, const Address&>(),
                                       MakeCallback(&Transfer::Accepted, this));
        m_drone = Socket::CreateSocket(drone, TcpSocketFactory::GetTypeId());
        m_drone->SetConnectCallback(MakeCallback(&Transfer::Connected, this), MakeNullCallback<void, Ptr<Socket>>());
        m_drone->SetSendCallback(MakeCallback(&Transfer::Send, this));
        m_drone->SetRecvCallback(MakeCallback(&Transfer::ReadAnswer, this));
        m_drone->Connect(InetSocketAddress(serverAddress, PORT));
    }

    double transferS{INFINITY};
    double roundTripS{INFINITY};

  private:
    void Connected(Ptr<Socket> socket)
    {
        m_began = Simulator::Now();
        m_connected = true;
        Send(socket, socket->GetTxAvailable());
    }

    void Send(Ptr<Socket> socket, uint32_t room)
    {
        while (m_connected && m_unsent > 0 && room > 0)
        {
            int sent = socket->Send(Create<Packet>(std::min(m_unsent, room)));
            if (sent <= 0)
                return;
            m_unsent -= sent;
            room = socket->GetTxAvailable();
        }
    }

    void Accepted(Ptr<Socket> socket, const Address&)
    {
        socket->SetRecvCallback(MakeCallback(&Transfer::ReadRequest, this));
    }

    void ReadRequest(Ptr<Socket> socket)
    {
        if (!Took(socket, m_missing))
            return;
        transferS = (Simulator::Now() - m_began).GetSeconds();
        socket->Send(Create<Packet>(ANSWER_BYTES));
    }

    void ReadAnswer(Ptr<Socket> socket)
    {
        if (!Took(socket, m_unanswered))
            return;
        roundTripS = (Simulator::Now() - m_began).GetSeconds();
        Simulator::Stop();
    }

    static bool Took(Ptr<Socket> socket, uint32_t& missing)
    {
        while (Ptr<Packet> packet = socket->Recv())
        {
            missing -= std::min(missing, packet->GetSize());
        }
        return missing == 0;
    }

    uint32_t m_unsent;
    uint32_t m_missing;
    uint32_t m_unanswered;
    bool m_connected{false};
    Time m_began;
    Ptr<Socket> m_listening;
    Ptr<Socket> m_drone;
};

static void
Run(const RadioSettings& settings, double distanceM, uint32_t bytes)
{
    auto air = MakeAir(settings);
    auto server = MakeStation(air, settings, 0, 0);
    auto drone = MakeStation(air, settings, distanceM, 0);
    InternetStackHelper internet;
    internet.Install(server->GetNode());
    internet.Install(drone->GetNode());
    Ipv4AddressHelper addresses("10.0.0.0", "255.255.255.0");
    auto serverAddress = addresses.Assign(NetDeviceContainer(server)).GetAddress(0);
    addresses.Assign(NetDeviceContainer(drone));
    Transfer transfer(drone->GetNode(), server->GetNode(), serverAddress, bytes);
    Simulator::Stop(Minutes(1));
    Simulator::Run();
    Simulator::Destroy();
    std::cout << transfer.transferS << " " << transfer.roundTripS << std::endl;
}

int
main(int count, char** words)
try
{
    std::ostringstream line;
    for (int index = 1; index < count; ++index)
    {
        line << words[index] << " ";
    }
    std::istringstream arguments(line.str());
    RadioSettings settings;
    double distanceM;
    uint32_t bytes;
    uint32_t firstSeed;
    uint32_t runs;
    if (!(arguments >> settings >> distanceM >> bytes >> firstSeed >> runs))
        throw std::invalid_argument("its arguments are STANDARD DATA_MODE CONTROL_MODE LOSS_AT_1M_DB LOSS_EXPONENT "
                                    "DISTANCE_M REQUEST_BYTES FIRST_SEED RUNS");
    Config::SetDefault("ns3::TcpSocket::SegmentSize", UintegerValue(1448));
    Config::SetDefault("ns3::TcpSocket::SndBufSize", UintegerValue(1 << 20));
    Config::SetDefault("ns3::TcpSocket::RcvBufSize", UintegerValue(1 << 20));
    for (uint32_t seed = firstSeed; seed < firstSeed + runs; ++seed)
    {
        RngSeedManager::SetSeed(seed);
        Run(settings, distanceM, bytes);
    }
    return 0;
}
catch (const std::exception& error)
{
    std::cerr << "goodput: " << error.what() << std::endl;
    return 1;
}
