/* A guidance law whose first word of the configuration selects a fault from its 20th call on. */
#define _DEFAULT_SOURCE /* sleep */
#include "lunarsim.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef VERSION
#define VERSION LUNARSIM_INTERFACE_VERSION
#endif

typedef struct {
    char fault[64];
    int calls;
    double gravity;
} State;

uint32_t lunarsim_interface_version(void) { return VERSION; }

int lunarsim_guidance_init(const LunarsimBriefing *briefing, void **state)
{
    State *s = calloc(1, sizeof *s);
    memcpy(s->fault, briefing->configuration, sizeof s->fault - 1);
    s->gravity = briefing->gravity;
    *state = s;
    return strcmp(s->fault, "init") == 0 ? 7 : 0;
}

int lunarsim_guidance_step(void *state, const LunarsimGuidanceInput *input,
                           LunarsimGuidanceOutput *output)
{
    State *s = state;
    (void)input;
    output->acceleration[0] = output->acceleration[1] = 0.0;
    output->acceleration[2] = s->gravity;
    if (s->calls++ < 20) {
        return 0;
    }
    if (strcmp(s->fault, "crash") == 0) {
        raise(SIGSEGV);
    }
    if (strcmp(s->fault, "abort") == 0) {
        abort();
    }
    if (strcmp(s->fault, "exit") == 0) {
        exit(3);
    }
    if (strcmp(s->fault, "hang") == 0) {
        for (;;) {
            sleep(1);
        }
    }
    if (strcmp(s->fault, "nan") == 0) {
        output->acceleration[1] = NAN;
    }
    return strcmp(s->fault, "error") == 0 ? 5 : 0;
}

void lunarsim_guidance_close(void *state) { free(state); }
