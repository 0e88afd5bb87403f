// Stands before libc's connections (LD_PRELOAD) of Python, Rust and C++ alike: what would leave this machine is refused, and
// written as a line into the file that METASCENES_TEST_EGRESS names.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

static void note(const char *what, const char *where) {
    char line[512];
    int size = snprintf(line, sizeof line, "%s %s\n", what, where);
    int file = open(getenv("METASCENES_TEST_EGRESS"), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
    if (file < 0 || write(file, line, size) != size) abort();
    close(file);
}

static bool leaves(const char *what, const sockaddr *address) {
    char text[INET6_ADDRSTRLEN] = "";
    if (address == nullptr) return false;
    if (address->sa_family == AF_INET) {
        auto *four = reinterpret_cast<const sockaddr_in *>(address);
        if (ntohl(four->sin_addr.s_addr) >> 24 == 127 || four->sin_addr.s_addr == 0) return false;
        inet_ntop(AF_INET, &four->sin_addr, text, sizeof text);
    } else if (address->sa_family == AF_INET6) {
        auto *six = reinterpret_cast<const sockaddr_in6 *>(address);
        if (IN6_IS_ADDR_LOOPBACK(&six->sin6_addr) || IN6_IS_ADDR_UNSPECIFIED(&six->sin6_addr)) return false;
        inet_ntop(AF_INET6, &six->sin6_addr, text, sizeof text);
    } else {
        return false;
    }
    note(what, text);
    errno = ENETUNREACH;
    return true;
}

template <class F> static F real(const char *name) { return reinterpret_cast<F>(dlsym(RTLD_NEXT, name)); }

extern "C" int connect(int fd, const sockaddr *address, socklen_t size) {
    if (leaves("connect", address)) return -1;
    return real<decltype(&connect)>("connect")(fd, address, size);
}

extern "C" ssize_t sendto(int fd, const void *data, size_t length, int flags, const sockaddr *address, socklen_t size) {
    if (leaves("sendto", address)) return -1;
    return real<decltype(&sendto)>("sendto")(fd, data, length, flags, address, size);
}

extern "C" ssize_t sendmsg(int fd, const msghdr *message, int flags) {
    if (message && leaves("sendmsg", static_cast<const sockaddr *>(message->msg_name))) return -1;
    return real<decltype(&sendmsg)>("sendmsg")(fd, message, flags);
}

extern "C" int getaddrinfo(const char *name, const char *service, const addrinfo *hints, addrinfo **found) {
    unsigned char bytes[16];
    if (name && *name && strcmp(name, "localhost") && inet_pton(AF_INET, name, bytes) != 1 && inet_pton(AF_INET6, name, bytes) != 1) {
        char own[256] = "";
        gethostname(own, sizeof own - 1);
        if (strcmp(name, own)) {
            note("getaddrinfo", name);
            return EAI_NONAME;
        }
    }
    return real<decltype(&getaddrinfo)>("getaddrinfo")(name, service, hints, found);
}
