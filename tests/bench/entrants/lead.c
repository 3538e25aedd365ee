/* An entrant of HILDOCK-1, written from its page: the phase lead. Prints its port, then answers. */
#include <arpa/inet.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

int main(void)
{
    struct sockaddr_in own = {0}, peer;
    socklen_t size = sizeof own;
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    own.sin_family = AF_INET;
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    bind(s, (struct sockaddr *)&own, size);
    getsockname(s, (struct sockaddr *)&own, &size);
    printf("%d\n", ntohs(own.sin_port));
    fflush(stdout);
    alarm(60); /* never outlives its test */

    double h = 0, m = 0, x = 0, v = 0, delay = 0, used = 0, before = 0, noise = 0, lag = 0.0005;
    for (;;) {
        char in[512], out[512];
        int number, k, ticks;
        double f;
        size = sizeof peer;
        ssize_t n = recvfrom(s, in, sizeof in - 1, 0, (struct sockaddr *)&peer, &size);
        if (n < 0) return 1;
        in[n] = 0;
        if (sscanf(in, "hildock 1 start %d %d %lf %lf %lf %lf %lf %lf", &number, &ticks, &h, &m, &x, &v,
                   &delay, &noise) == 8) {
            used = before = 0;
            snprintf(out, sizeof out, "ready %d", number);
        } else if (sscanf(in, "end %d", &number) == 1) {
            snprintf(out, sizeof out, "done %d", number);
        } else if (sscanf(in, "%d %d %lf", &number, &k, &f) == 3) {
            double a = lag / h, b = (delay + lag) / h;
            used = (used * a + f + b * (f - before)) / (1.0 + a);
            before = f;
            v -= h * used / m;
            x += h * v;
            snprintf(out, sizeof out, "%d %d %.17g", number, k, x);
        } else {
            return 0;
        }
        sendto(s, out, strlen(out), 0, (struct sockaddr *)&peer, size);
    }
}
