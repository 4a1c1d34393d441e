// SPDX-License-Identifier: Apache-2.0
// The limit: mj_step in a plain loop, one thread a core, each on its own mjData.
// Usage: mj_step_loop MODEL.mjb THREADS SAMPLES SUBSTEPS; prints steps per second.
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <mujoco/mujoco.h>

static const mjModel* model;
static long samples, substeps;

static void* work(void* number) {
  mjData* data = mj_makeData(model);
  double phase = (double)(long)number;
  for (long k = 0; k < samples; k++) {
    for (int i = 0; i < model->nu; i++) data->ctrl[i] = 0.3 * sin(0.05 * k + phase + i);
    for (long s = 0; s < substeps; s++) mj_step(model, data);
  }
  mj_deleteData(data);
  return NULL;
}

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  char error[1000] = "";
  model = mj_loadModel(argv[1], NULL);
  if (!model) { fprintf(stderr, "cannot load %s %s\n", argv[1], error); return 2; }
  int threads = atoi(argv[2]);
  samples = atol(argv[3]);
  substeps = atol(argv[4]);
  pthread_t* pool = malloc(threads * sizeof(pthread_t));
  struct timespec t0, t1;
  clock_gettime(CLOCK_MONOTONIC, &t0);
  for (long i = 0; i < threads; i++) pthread_create(&pool[i], NULL, work, (void*)i);
  for (int i = 0; i < threads; i++) pthread_join(pool[i], NULL);
  clock_gettime(CLOCK_MONOTONIC, &t1);
  double seconds = (t1.tv_sec - t0.tv_sec) + 1e-9 * (t1.tv_nsec - t0.tv_nsec);
  printf("%.1f\n", threads * (double)samples * substeps / seconds);
  return 0;
}
