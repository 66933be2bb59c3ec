/* A computer that falls freely, and fails in the cycle of the touchdown. */
#include "lunarsim.h"

#include <stdlib.h>

uint32_t lunarsim_interface_version(void) { return LUNARSIM_INTERFACE_VERSION; }

int lunarsim_computer_init(const LunarsimBriefing *briefing, void **state)
{
    LunarsimBriefing *copy = malloc(sizeof *copy);
    *copy = *briefing;
    *state = copy;
    return 0;
}

int lunarsim_computer_step(void *state, const LunarsimMeasurements *input, LunarsimCommand *output)
{
    const LunarsimBriefing *briefing = state;
    output->thrust = 0.0;
    output->attitude[0] = output->attitude[1] = output->attitude[2] = 0.0;
    output->attitude[3] = 1.0;
    for (int k = 0; k < 3; k++) {
        output->estimate.position[k] = briefing->start_position[k];
        output->estimate.velocity[k] = output->estimate.rate[k] = 0.0;
    }
    for (int k = 0; k < 4; k++) {
        output->estimate.attitude[k] = output->attitude[k];
    }
    output->estimate.mass = 1500.0;
    /* The cycle of the touchdown has fewer samples. */
    if (input->inertial_samples_count == 0) {
        return 0;
    }
    return input->inertial_samples[0].sample_count < briefing->cycle / briefing->step - 0.5 ? 5 : 0;
}

void lunarsim_computer_close(void *state) { free(state); }
