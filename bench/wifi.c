/* A link between two network namespaces as a robot's Wi-Fi is, for kernels without netem: a tun device in each.
 *
 * wifi PID_A IP_A PID_B IP_B DELAY_MS JITTER_MS LOSS_% RATE_BPS QUEUE_BYTES GAP_EVERY_S GAP_LEN_S
 *
 * Each direction has a queue and a rate of its own; packets keep their order. A gap loses everything, both ways. It prints
 * "up", "gap 1 SECONDS" and "gap 0 SECONDS" (CLOCK_MONOTONIC), and on SIGUSR1 and at its end the bytes of both directions. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <linux/if.h>
#include <linux/if_tun.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

enum { LONGEST = 2000, AT_ONCE = 256 };

struct packet {
  double due;
  int size;
  struct packet *next;
  unsigned char data[LONGEST];
};

struct direction {
  struct packet *head, **end;
  double free_at, last_due;
  long long bytes, lost, overflown;
};

static volatile sig_atomic_t stopped, asked;
static void stop(int signal) { stopped = 1; }
static void ask(int signal) { asked = 1; }

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec + time.tv_nsec * 1e-9;
}

static void fail(const char *what) {
  perror(what);
  exit(1);
}

static int device(const char *pid, const char *ip, const char *peer, int home) {
  char text[300];
  snprintf(text, sizeof text, "/proc/%s/ns/net", pid);
  int space = open(text, O_RDONLY);
  if (space < 0 || setns(space, CLONE_NEWNET)) fail(text);
  close(space);
  int tun = open("/dev/net/tun", O_RDWR | O_NONBLOCK);
  struct ifreq request = {.ifr_flags = IFF_TUN | IFF_NO_PI, .ifr_name = "wl0"};
  if (tun < 0 || ioctl(tun, TUNSETIFF, &request)) fail("/dev/net/tun");
  snprintf(text, sizeof text, "ip addr add %s peer %s dev wl0; ip link set wl0 mtu 1500 txqueuelen 200 up", ip, peer);
  if (system(text)) fail("ip");
  if (setns(home, CLONE_NEWNET)) fail("setns");
  return tun;
}

static void report(struct direction *ways) {
  printf("bytes %lld %lld lost %lld %lld overflown %lld %lld\n", ways[0].bytes, ways[1].bytes, ways[0].lost, ways[1].lost,
         ways[0].overflown, ways[1].overflown);
  fflush(stdout);
}

int main(int count, char **words) {
  if (count != 12) return 2;
  int home = open("/proc/self/ns/net", O_RDONLY);
  int ends[2] = {device(words[1], words[2], words[4], home), device(words[3], words[4], words[2], home)};
  double delay = atof(words[5]) / 1e3, jitter = atof(words[6]) / 1e3, loss = atof(words[7]) / 100;
  double rate = atof(words[8]) / 8, queue = atof(words[9]), gap_every = atof(words[10]), gap_length = atof(words[11]);
  struct direction ways[2] = {0};
  for (int i = 0; i < 2; i++) ways[i].end = &ways[i].head;
  signal(SIGTERM, stop), signal(SIGINT, stop), signal(SIGUSR1, ask);
  srand48(7); /* the same link each time */
  double began = now();
  int gap = 0;
  printf("up\n"), fflush(stdout);
  while (!stopped) {
    double time = now(), wake = time + 0.05; /* a gap begins or ends without a packet, so late at most */
    for (int i = 0; i < 2; i++)
      if (ways[i].head && ways[i].head->due < wake) wake = ways[i].head->due;
    struct pollfd polls[2] = {{ends[0], POLLIN}, {ends[1], POLLIN}};
    struct timespec pause = {0, wake > time ? (wake - time) * 1e9 : 0};
    ppoll(polls, 2, &pause, NULL);
    time = now();
    double since = time - began;
    int in_gap = gap_every > 0 && since > gap_every && since - gap_every * (int)(since / gap_every) < gap_length;
    if (in_gap != gap) {
      gap = in_gap;
      printf("gap %d %.3f\n", gap, time), fflush(stdout);
    }
    for (int i = 0; i < 2; i++) {
      struct direction *way = &ways[i];
      for (int k = 0; k < AT_ONCE; k++) { /* a flood from one end must not keep the other from its turn */
        struct packet *packet = malloc(sizeof *packet);
        packet->next = NULL;
        packet->size = read(ends[i], packet->data, LONGEST);
        double waits = way->free_at > time ? (way->free_at - time) * rate : 0;
        if (packet->size <= 0) {
          free(packet);
          break;
        }
        if (gap || waits + packet->size > queue) {
          way->overflown += !gap;
          free(packet);
          continue;
        }
        if (way->free_at < time) way->free_at = time;
        way->free_at += packet->size / rate; /* a lost packet has taken its time on the air, too */
        if (drand48() < loss) {
          way->lost++;
          free(packet);
          continue;
        }
        packet->due = way->free_at + delay + (drand48() * 2 - 1) * jitter;
        if (packet->due < way->last_due) packet->due = way->last_due;
        way->last_due = packet->due;
        way->bytes += packet->size;
        *way->end = packet;
        way->end = &packet->next;
      }
      time = now();
      while (way->head && way->head->due <= time) {
        struct packet *packet = way->head;
        way->head = packet->next;
        if (!way->head) way->end = &way->head;
        if (write(ends[1 - i], packet->data, packet->size) < 0) way->lost++;
        free(packet);
      }
    }
    if (asked) {
      asked = 0;
      began = now(); /* gaps count from the last question */
      report(ways);
    }
  }
  report(ways);
}
