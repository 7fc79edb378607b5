// A tap device in a network namespace: what the kernel sends through it is read here, what is written it receives.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

class Tap
{
  public:
    using Frame = std::vector<uint8_t>;

    // Makes the device in the namespace of that file; std::system_error where that fails. It goes with this object.
    Tap(const std::string& namespaceFile, const std::string& device);
    Tap(Tap&& other) noexcept;
    Tap(const Tap&) = delete;
    ~Tap();

    void SetAddress(const uint8_t (&bytes)[6]);

    // Waits for the next frame; an empty one when there will be none.
    Frame Read();
    void Write(const Frame& frame);

  private:
    int m_file;
};
