// The radio of an emulation: for each drone and server a ghost station on a simulated WiFi channel, in real time.
//
// A station's frames come from a tap device in the namespace of the program that it stands for, and go there. Standard
// input first says what there is, a line each, and `go`; then where stations are. Its end ends the program, so that
// nothing is left behind when whoever started it is gone.
//
//     cell NAME STANDARD DATA_MODE CONTROL_MODE LOSS_AT_1M_DB LOSS_EXPONENT
//     station NAME CELL NAMESPACE_FILE DEVICE EAST_M NORTH_M
//     go
//     move NAME EAST_M NORTH_M
//
// Standard output says `ready` once all devices are there, then each second `lag S`: how far the simulation was behind
// the clock at most since the last line.

#include "tap.h"
#include "wifi.h"

#include <ns3/ethernet-header.h>
#include <ns3/global-value.h>
#include <ns3/realtime-simulator-impl.h>
#include <ns3/simulator.h>
#include <ns3/string.h>

#include <algorithm>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <thread>

using namespace ns3;

// Why no ns3::TapBridge: it changes the station's address at the first frame, which the part that acknowledges
// frames does not notice, and it creates devices through a program that Debian does not ship.
class Ghost
{
  public:
    Ghost(Ptr<WifiNetDevice> station, Tap tap)
        : m_station(station),
          m_tap(std::move(tap))
    {
        auto address = Mac48Address::ConvertFrom(station->GetAddress());
        uint8_t bytes[6];
        address.CopyTo(bytes);
        m_tap.SetAddress(bytes);
        station->SetReceiveCallback(MakeCallback(&Ghost::Receive, this));
        std::thread(&Ghost::ReadFrames, this).detach();
    }

    Ptr<WifiNetDevice> Station() const
    {
        return m_station;
    }

  private:
    // On a thread of its own: hands each frame over to the simulation.
    void ReadFrames()
    {
        const uint32_t context = m_station->GetNode()->GetId();
        for (Tap::Frame frame = m_tap.Read(); !frame.empty(); frame = m_tap.Read())
        {
            Simulator::ScheduleWithContext(context, Time(0), [this, frame] { Send(frame); });
        }
    }

    void Send(const Tap::Frame& frame)
    {
        auto packet = Create<Packet>(frame.data(), frame.size());
        EthernetHeader header(false);
        if (frame.size() < header.GetSerializedSize())
            return;
        packet->RemoveHeader(header);
        m_station->Send(packet, header.GetDestination(), header.GetLengthType());
    }

    bool Receive(Ptr<NetDevice>, Ptr<const Packet> received, uint16_t protocol, const Address& from)
    {
        EthernetHeader header(false);
        header.SetSource(Mac48Address::ConvertFrom(from));
        header.SetDestination(Mac48Address::ConvertFrom(m_station->GetAddress()));
        header.SetLengthType(protocol);
        auto packet = received->Copy();
        packet->AddHeader(header);
        Tap::Frame frame(packet->GetSize());
        packet->CopyData(frame.data(), frame.size());
        m_tap.Write(frame);
        return true;
    }

    Ptr<WifiNetDevice> m_station;
    Tap m_tap;
};

struct Cell
{
    RadioSettings settings;
    Ptr<YansWifiChannel> air;
};

class Field
{
  public:
    // Reads what there is, up to `go`.
    void SetUp(std::istream& input)
    {
        for (std::string line; std::getline(input, line);)
        {
            std::istringstream words(line);
            std::string what;
            words >> what;
            if (what == "go")
                return;
            if (what == "cell")
                AddCell(words);
            else if (what == "station")
                AddStation(words);
            else
                words.setstate(std::ios::failbit);
            if (!words)
                throw std::invalid_argument("not understood: " + line);
        }
        throw std::invalid_argument("no line `go`");
    }

    // Reads positions, on a thread of its own, until the input's end, which ends the simulation.
    void Follow(std::istream& input)
    {
        std::string what;
        std::string name;
        double eastM;
        double northM;
        while (input >> what >> name >> eastM >> northM)
        {
            auto ghost = m_ghosts.find(name);
            if (what != "move" || ghost == m_ghosts.end())
                continue;
            auto station = ghost->second->Station();
            Simulator::ScheduleWithContext(station->GetNode()->GetId(), Time(0), [station, eastM, northM] {
                MoveStation(station, eastM, northM);
            });
        }
        Simulator::ScheduleWithContext(Simulator::NO_CONTEXT, Time(0), [] { Simulator::Stop(); });
    }

  private:
    void AddCell(std::istream& words)
    {
        std::string name;
        RadioSettings settings;
        if (words >> name >> settings)
            m_cells[name] = Cell{settings, MakeAir(settings)};
    }

    void AddStation(std::istream& words)
    {
        std::string name;
        std::string cellName;
        std::string namespaceFile;
        std::string device;
        double eastM;
        double northM;
        if (!(words >> name >> cellName >> namespaceFile >> device >> eastM >> northM))
            return;
        const Cell& cell = m_cells.at(cellName);
        auto station = MakeStation(cell.air, cell.settings, eastM, northM);
        m_ghosts[name] = std::make_unique<Ghost>(station, Tap(namespaceFile, device));
    }

    std::map<std::string, Cell> m_cells;
    std::map<std::string, std::unique_ptr<Ghost>> m_ghosts;
};

// Looks a hundred times a second how far the simulation is behind the clock.
class LagWatch
{
  public:
    void Look()
    {
        auto simulator = DynamicCast<RealtimeSimulatorImpl>(Simulator::GetImplementation());
        m_worst = std::max(m_worst, simulator->RealtimeNow() - Simulator::Now());
        if (++m_looks % 100 == 0)
        {
            std::cout << "lag " << m_worst.GetSeconds() << std::endl;
            m_worst = Time(0);
        }
        Simulator::Schedule(MilliSeconds(10), &LagWatch::Look, this);
    }

  private:
    Time m_worst{0};
    int m_looks{0};
};

int
main()
try
{
    GlobalValue::Bind("SimulatorImplementationType", StringValue("ns3::RealtimeSimulatorImpl"));
    Field field;
    field.SetUp(std::cin);
    LagWatch watch;
    Simulator::Schedule(MilliSeconds(10), &LagWatch::Look, &watch);
    Simulator::ScheduleNow([] { std::cout << "ready" << std::endl; });
    std::thread following(&Field::Follow, &field, std::ref(std::cin));
    Simulator::Run();
    std::quick_exit(0); // the threads that wait for frames hold nothing that needs an orderly end
}
catch (const std::exception& error)
{
    std::cerr << "ghosts: " << error.what() << std::endl;
    std::quick_exit(1);
}
