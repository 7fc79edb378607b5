// The service of detail.py in C++: docs/services.md says what it reads and writes.
// g++ -std=c++17 -O2 detail.cpp -o detail    (Debian: apt install g++ nlohmann-json3-dev)
#include <array>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

using nlohmann::json;

// A frame is its length, four bytes with the highest first, and so many bytes of MessagePack.
std::optional<json> read_frame() {
    std::array<unsigned char, 4> head;
    if (!std::cin.read(reinterpret_cast<char *>(head.data()), head.size())) return std::nullopt;
    std::vector<std::uint8_t> body(std::uint32_t(head[0]) << 24 | head[1] << 16 | head[2] << 8 | head[3]);
    if (!std::cin.read(reinterpret_cast<char *>(body.data()), body.size())) return std::nullopt;
    return json::from_msgpack(body);
}

void write_frame(const json &message) {
    const auto body = json::to_msgpack(message);
    for (int shift = 24; shift >= 0; shift -= 8) std::cout.put(char(body.size() >> shift));
    std::cout.write(reinterpret_cast<const char *>(body.data()), body.size()).flush();
}

json measure(const json &arguments, double blank_below) {
    const auto &photo = arguments.at("photo").get_binary();
    if (photo.empty()) throw std::invalid_argument("the photo is empty");
    std::array<std::size_t, 256> counts{};
    for (const auto byte : photo) ++counts[byte];
    double bits = 0;
    for (const auto count : counts)
        if (count != 0) bits -= double(count) / photo.size() * std::log2(double(count) / photo.size());
    return {{"bits_per_byte", bits}, {"is_blank", bits < blank_below}};
}

int main() {
    std::ios::sync_with_stdio(false);
    const auto first = read_frame();
    if (!first) return 1;
    const double blank_below = first->at("settings").value("blank_below", 1.0);
    write_frame({{"id", 0}, {"value", nullptr}});
    while (const auto call = read_frame()) {
        json answer = {{"id", call->at("id")}};
        try {
            answer["value"] = measure(call->at("arguments"), blank_below);
        } catch (const std::invalid_argument &error) {
            answer["fault"] = {{"type", "builtins:ValueError"}, {"message", error.what()}};
        }
        write_frame(answer);
    }
}
