/* Attitude control and a mapper for tests: the control is lunarsim's `pd` with default gains. The
 * mapper marks each cell safe in which a scan has a point; the elevation is the point's height. */
#include "lunarsim.h"

#include <math.h>
#include <stddef.h>

uint32_t lunarsim_interface_version(void) { return LUNARSIM_INTERFACE_VERSION; }

int lunarsim_control_init(const LunarsimBriefing *briefing, void **state)
{
    *state = NULL;
    return briefing->step > 0.0 ? 0 : 1;
}

int lunarsim_control_step(void *state, const LunarsimControlInput *input,
                          LunarsimControlOutput *output)
{
    const double frequency = 4.0, damping = 0.9, limit = 15.0 * (3.14159265358979323846 / 180.0);
    (void)state;
    for (int k = 0; k < 3; k++) {
        double wanted = frequency / (2.0 * damping) * input->error[k];
        wanted = fmin(fmax(wanted, -limit), limit);
        output->torque[k] =
            input->inertia[k] * 2.0 * damping * frequency * (wanted - input->rate[k]);
    }
    return 0;
}

void lunarsim_control_close(void *state) { (void)state; }

int lunarsim_mapper_init(const LunarsimBriefing *briefing, void **state)
{
    *state = NULL;
    return briefing->sensor_count > 0 ? 0 : 1;
}

/* Rotate a vector by a quaternion with the scalar last. */
static void rotate(const double q[4], const double v[3], double out[3])
{
    double t[3];
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        t[k] = 2.0 * (q[i] * v[j] - q[j] * v[i]);
    }
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        out[k] = v[k] + q[3] * t[k] + q[i] * t[j] - q[j] * t[i];
    }
}

int lunarsim_mapper_step(void *state, const LunarsimMapperInput *input,
                         LunarsimMapperOutput *output)
{
    const LunarsimGrid *grid = &input->grid;
    (void)state;
    for (uint32_t n = 0; n < input->lidar_scan_count; n++) {
        const LunarsimLidarScan *scan = &input->lidar_scan[n];
        for (uint32_t i = 0; i < scan->rows * scan->cols; i++) {
            double body[3], point[3];
            if (isnan(scan->range[i])) {
                continue;
            }
            for (int k = 0; k < 3; k++) {
                body[k] = 0.0;
                for (int j = 0; j < 3; j++) {
                    body[k] += scan->mount[k][j] * scan->direction[3 * i + j] * scan->range[i];
                }
            }
            rotate(input->estimate.attitude, body, point);
            double col = (point[0] + input->estimate.position[0] - grid->x0) / grid->posting;
            double row = (point[1] + input->estimate.position[1] - grid->y0) / grid->posting;
            if (col > -0.5 && row > -0.5 && col < grid->cols - 0.5 && row < grid->rows - 0.5) {
                size_t at = (size_t)(row + 0.5) * grid->cols + (size_t)(col + 0.5);
                input->p_safe[at] = 0.75f;
                input->observed[at] = 1;
                input->elevation[at] = (float)(point[2] + input->estimate.position[2]);
                output->changed = 1;
            }
        }
    }
    return 0;
}

void lunarsim_mapper_close(void *state) { (void)state; }
