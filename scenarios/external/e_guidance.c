/* E-guidance of the approach: a guidance law in C.
 *
 * cmake -S . -B build && cmake --build build
 * lunarsim fly golombek --set guidance.kind=library --set guidance.path=build/e_guidance.so \
 *     --allow-program build/e_guidance.so
 *
 * The thrust acceleration is linear in time and leads to the required position and velocity (Cherry,
 * 1964). The law is evaluated for the state that follows after the response time of the vehicle.
 * e_guidance.py is the same law in Python.
 */
#include "lunarsim.h"

#include <stdlib.h>

/* Time-to-go below which the law keeps its last gains, s. */
#define MIN_TIME_TO_GO 1.5

typedef struct {
    double gravity; /* m/s^2 */
    double lag;     /* response time of attitude control and engine, s */
} Law;

uint32_t lunarsim_interface_version(void) { return LUNARSIM_INTERFACE_VERSION; }

int lunarsim_guidance_init(const LunarsimBriefing *briefing, void **state)
{
    Law *law = malloc(sizeof *law);
    if (law == NULL) {
        return 1;
    }
    law->gravity = briefing->gravity;
    law->lag = briefing->lag;
    *state = law;
    return 0;
}

int lunarsim_guidance_step(void *state, const LunarsimGuidanceInput *input,
                           LunarsimGuidanceOutput *output)
{
    const Law *law = state;
    const double *position = input->estimate.position, *velocity = input->estimate.velocity;
    double left = input->time_to_go - law->lag;
    if (input->phase != LUNARSIM_GUIDANCE_PHASE_APPROACH) {
        return 1; /* this library has no terminal descent */
    }
    if (left < MIN_TIME_TO_GO) {
        left = MIN_TIME_TO_GO;
    }
    for (int k = 0; k < 3; k++) {
        double ahead = position[k] + law->lag * velocity[k];
        double miss = input->end.position[k] - ahead - left * input->end.velocity[k];
        double change = input->end.velocity[k] - velocity[k];
        output->acceleration[k] = (6.0 * miss / left + 4.0 * change) / left;
    }
    output->acceleration[2] += law->gravity;
    return 0;
}

void lunarsim_guidance_close(void *state) { free(state); }
