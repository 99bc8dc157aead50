// C++: std::thread, std::condition_variable with a predicate, std::async, std::shared_mutex and std::random_device, over UDP.
#include <arpa/inet.h>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <deque>
#include <future>
#include <iostream>
#include <random>
#include <shared_mutex>
#include <string>
#include <sys/socket.h>
#include <thread>
using namespace std::chrono_literals;
int main(int, char **v) {
    int me = std::stoi(v[1]), s = socket(AF_INET, SOCK_DGRAM, 0); sockaddr_in a{}, to{}; a.sin_family = to.sin_family = AF_INET; a.sin_port = to.sin_port = htons(5072); to.sin_addr.s_addr = htonl(0x0A000003 - me); bind(s, (sockaddr *)&a, sizeof a);
    std::mutex m; std::condition_variable c; std::deque<std::string> q; std::shared_mutex stats; int n = 0; auto start = std::chrono::steady_clock::now();
    std::thread hear([&] { for (int k = 0; k < 3; k++) { char b[100]; auto z = recv(s, b, 99, 0); { std::lock_guard l(m); q.emplace_back(b, z); } c.notify_one(); std::unique_lock w(stats); n++; } });
    auto sent = std::async(std::launch::async, [&] { for (int k = 0; k < 3; k++) { std::this_thread::sleep_until(start + (k + 1) * 1s); std::string b = std::to_string(k) + " of " + std::to_string(me); sendto(s, b.data(), b.size(), 0, (sockaddr *)&to, sizeof to); } return 3; });
    for (int got = 0, late = 0; got < 3;) { std::unique_lock l(m); if (!c.wait_for(l, 600ms, [&] { return !q.empty(); })) { if (++late > 8) return 1; continue; }
        std::printf("%.1f heard %s\n", std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), q.front().c_str()); q.pop_front(); got++; }
    hear.join(); std::shared_lock r(stats); std::cout << "sent " << sent.get() << " heard " << n << std::endl;
    std::random_device d; std::mt19937 g(d()); std::cout << "random_device " << d() << " " << g() << std::endl; std::this_thread::sleep_for(2s); std::cout << "done" << std::endl; }
