/* A guidance law whose first word of the configuration selects a fault from its 20th call on. */
#define _DEFAULT_SOURCE /* sleep */
#include "lunarsim.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef VERSION
#define VERSION LUNARSIM_INTERFACE_VERSION
#endif

typedef struct {
    char fault[512];
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
    if (s->calls++ < (strstr(s->fault, "at once") ? 0 : 20)) {
        output->acceleration[0] = output->acceleration[1] = 0.0;
        output->acceleration[2] = s->gravity;
        return 0;
    }
    if (strncmp(s->fault, "crash", 5) == 0) {
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
    if (strcmp(s->fault, "silent") == 0) {
        output->acceleration[0] = input->estimate.mass;
        return 0;
    }
    output->acceleration[0] = output->acceleration[2] = 0.0;
    output->acceleration[1] = strcmp(s->fault, "nan") == 0 ? NAN : 0.0;
    return strcmp(s->fault, "error") == 0 ? 5 : 0;
}

/* Leave a file if the configuration is "close FILE". */
void lunarsim_guidance_close(void *state)
{
    State *s = state;
    if (strncmp(s->fault, "close ", 6) == 0) {
        FILE *file = fopen(s->fault + 6, "a");
        fputs("closed\n", file);
        fclose(file);
    }
    free(state);
}
