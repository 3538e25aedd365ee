/* The phase lead of HILDOCK-1 as an FMU for co-simulation, written from the page and the standard:
   FMI 3.0, or 2.0 with -DFMI2. Value references: y 0, x 1, h 2, m 3, x0 4, v0 5, delay 6, noise 7.
   -DFAULT=STATEMENT: what goes wrong at the fourth step. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { Y, X, H, M, X0, V0, DELAY, NOISE, COUNT };
typedef struct { double value[COUNT], v, used, before; int steps; } Lead;
static const double LAG = 0.0005;

static void start(Lead *s) { s->value[X] = s->value[X0]; s->v = s->value[V0]; }

static int advance(Lead *s, double h, bool *ended)
{
    double *p = s->value, a = LAG / h, b = (p[DELAY] + LAG) / h;
    s->used = (s->used * a + p[Y] + b * (p[Y] - s->before)) / (1.0 + a);
    s->before = p[Y];
    s->v -= h * s->used / p[M];
    p[X] += h * s->v;
#ifdef FAULT
    if (++s->steps == 4) { puts("an FMU may print"); fflush(stdout); FAULT; }
#endif
    return 0;
}

static int put(Lead *s, const unsigned *ref, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) s->value[ref[i]] = v[i];
    return 0;
}

static int get(Lead *s, const unsigned *ref, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) v[i] = s->value[ref[i]];
    return 0;
}

#ifdef FMI2
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *c, int v, int l)
{ return calloc(1, sizeof(Lead)); }
int fmi2SetupExperiment(Lead *s, int d, double t, double a, int e, double b) { return 0; }
int fmi2EnterInitializationMode(Lead *s) { start(s); return 0; }
int fmi2ExitInitializationMode(Lead *s) { return 0; }
int fmi2SetReal(Lead *s, const unsigned *r, size_t n, const double *v) { return put(s, r, n, v); }
int fmi2GetReal(Lead *s, const unsigned *r, size_t n, double *v) { return get(s, r, n, v); }
int fmi2DoStep(Lead *s, double t, double h, int n) { bool end; return advance(s, h, &end); }
int fmi2Terminate(Lead *s) { return 0; }
void fmi2FreeInstance(Lead *s) { free(s); }
#else
void *fmi3InstantiateCoSimulation(const char *n, const char *t, const char *r, bool v, bool l, bool e, bool y,
                                  const unsigned *q, size_t nq, void *env, void *log, void *mid)
{ return calloc(1, sizeof(Lead)); }
int fmi3EnterInitializationMode(Lead *s, bool d, double t, double a, bool e, double b) { start(s); return 0; }
int fmi3ExitInitializationMode(Lead *s) { return 0; }
int fmi3SetFloat64(Lead *s, const unsigned *r, size_t n, const double *v, size_t m) { return put(s, r, n, v); }
int fmi3GetFloat64(Lead *s, const unsigned *r, size_t n, double *v, size_t m) { return get(s, r, n, v); }
int fmi3DoStep(Lead *s, double t, double h, bool n, bool *event, bool *end, bool *early, double *last)
{
    *event = *end = *early = false;
    *last = t + h;
    return advance(s, h, end);
}
int fmi3Terminate(Lead *s) { return 0; }
void fmi3FreeInstance(Lead *s) { free(s); }
#endif
