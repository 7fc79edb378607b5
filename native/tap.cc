#include "tap.h"

#include <fcntl.h>
#include <linux/if.h>
#include <linux/if_arp.h>
#include <linux/if_tun.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <utility>

static const size_t LONGEST_FRAME = 2048;

static int
Checked(int result, const std::string& what)
{
    if (result < 0)
        throw std::system_error(errno, std::generic_category(), what);
    return result;
}

// The calling thread, until the end of the block, in another network namespace.
class Inside
{
  public:
    explicit Inside(const std::string& namespaceFile)
        : m_home(Checked(open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC), "own namespace"))
    {
        int there = Checked(open(namespaceFile.c_str(), O_RDONLY | O_CLOEXEC), namespaceFile);
        Checked(setns(there, CLONE_NEWNET), namespaceFile);
        close(there);
    }

    ~Inside()
    {
        setns(m_home, CLONE_NEWNET);
        close(m_home);
    }

  private:
    int m_home;
};

Tap::Tap(const std::string& namespaceFile, const std::string& device)
{
    Inside inside(namespaceFile);
    m_file = Checked(open("/dev/net/tun", O_RDWR | O_CLOEXEC), "/dev/net/tun");
    ifreq request{};
    request.ifr_flags = IFF_TAP | IFF_NO_PI;
    device.copy(request.ifr_name, IFNAMSIZ - 1);
    Checked(ioctl(m_file, TUNSETIFF, &request), device);
}

Tap::Tap(Tap&& other) noexcept
    : m_file(std::exchange(other.m_file, -1))
{
}

Tap::~Tap()
{
    if (m_file >= 0)
        close(m_file);
}

void
Tap::SetAddress(const uint8_t (&bytes)[6])
{
    ifreq request{};
    request.ifr_hwaddr.sa_family = ARPHRD_ETHER;
    std::copy(std::begin(bytes), std::end(bytes), request.ifr_hwaddr.sa_data);
    Checked(ioctl(m_file, SIOCSIFHWADDR, &request), "hardware address");
}

Tap::Frame
Tap::Read()
{
    Frame frame(LONGEST_FRAME);
    ssize_t length;
    do
    {
        length = read(m_file, frame.data(), frame.size());
    } while (length < 0 && errno == EINTR);
    frame.resize(std::max<ssize_t>(length, 0));
    return frame;
}

void
Tap::Write(const Frame& frame)
{
    // A device that is down or full loses the frame, as a radio does.
    [[maybe_unused]] ssize_t written = write(m_file, frame.data(), frame.size());
}
