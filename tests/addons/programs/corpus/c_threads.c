// C: three threads over UDP: one hears, one sends at absolute times, one waits at a condition with a deadline.
#include <arpa/inet.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>
static int s, me, heard; static struct timespec start; static pthread_mutex_t m = PTHREAD_MUTEX_INITIALIZER; static pthread_cond_t c = PTHREAD_COND_INITIALIZER; static sem_t sent;
static double since(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec - start.tv_sec + (t.tv_nsec - start.tv_nsec) / 1e9; }
static void *hear(void *x) { for (char b[100]; ; ) { int n = recv(s, b, 99, 0); b[n > 0 ? n : 0] = 0; pthread_mutex_lock(&m); heard++; printf("%.1f heard %s\n", since(), b); fflush(stdout); pthread_cond_signal(&c); pthread_mutex_unlock(&m); } return 0; }
static void *send_(void *x) {
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(5070), .sin_addr.s_addr = htonl(0x0A000003 - me)}; struct timespec due = start; due.tv_nsec = 0; due.tv_sec += 1;
    for (int k = 0; k < 3; k++) { char b[50]; int n = sprintf(b, "%d of %d", k, me); due.tv_sec++; clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, 0); sendto(s, b, n, 0, (void *)&to, sizeof to); sem_post(&sent); }
    return 0; }
int main(int n, char **v) {
    me = atoi(v[1]); clock_gettime(CLOCK_MONOTONIC, &start); sem_init(&sent, 0, 0); s = socket(AF_INET, SOCK_DGRAM, 0); struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(5070)}; bind(s, (void *)&a, sizeof a);
    pthread_t t[2]; pthread_create(t, 0, hear, 0); pthread_create(t + 1, 0, send_, 0); int late = 0;
    for (int k = 0; k < 3; k++) sem_wait(&sent);
    pthread_mutex_lock(&m); while (heard < 4) { struct timespec w; clock_gettime(CLOCK_REALTIME, &w); w.tv_sec++; if (pthread_cond_timedwait(&c, &m, &w) && ++late == 2) break; } pthread_mutex_unlock(&m);
    pthread_join(t[1], 0); printf("%d heard, %d times late\n", heard, late); return heard != 3; }
