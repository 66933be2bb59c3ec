/* Complete onboard computer in C: navigation from external fixes, guidance to the target.
 *
 * cmake -S . -B build && cmake --build build
 * lunarsim fly golombek_fixes.toml --set computer.kind=library --set computer.path=build/computer.so
 *     --allow-program build/computer.so
 *
 * E-guidance flies to a point above the target, then the lander descends vertically. There is no
 * hazard map and no divert. lunarsim controls the attitude.
 */
#include "lunarsim.h"

#include <math.h>
#include <stdlib.h>

#define APPROACH_HEIGHT 25.0  /* height of the pads at the end of the approach, m */
#define APPROACH_SPEED 3.0    /* descent speed there, m/s */
#define TOUCHDOWN_SPEED 1.2   /* descent speed below SLOW_HEIGHT, m/s */
#define SLOW_HEIGHT 6.0       /* m */
#define MIN_TIME_TO_GO 1.5    /* s */
#define MAX_TILT 0.6          /* maximum tilt of the thrust in the approach, rad */
#define MAX_TILT_VERTICAL 0.1 /* in the vertical descent, rad */

typedef struct {
    double gravity, lag, arrival, mass, exhaust_velocity, cycle;
    double thrust_min, thrust_max, com_height, heading, thrust;
    double target[3];
    LunarsimEstimate estimate;
} Computer;

uint32_t lunarsim_interface_version(void) { return LUNARSIM_INTERFACE_VERSION; }

int lunarsim_computer_init(const LunarsimBriefing *briefing, void **state)
{
    Computer *c = calloc(1, sizeof *c);
    if (c == NULL) {
        return 1;
    }
    c->gravity = briefing->gravity;
    c->lag = briefing->lag;
    c->arrival = briefing->time_to_go;
    c->mass = briefing->vehicle.dry_mass + briefing->vehicle.propellant_mass;
    c->exhaust_velocity = briefing->vehicle.exhaust_velocity;
    c->thrust_min = briefing->vehicle.thrust_min;
    c->thrust_max = briefing->vehicle.thrust_max;
    c->com_height = briefing->vehicle.com_height;
    c->cycle = briefing->cycle;
    c->heading = briefing->heading;
    for (int k = 0; k < 3; k++) {
        c->target[k] = briefing->target[k];
        c->estimate.position[k] = briefing->start_position[k];
        c->estimate.velocity[k] = briefing->start_velocity[k];
    }
    for (int k = 0; k < 4; k++) {
        c->estimate.attitude[k] = briefing->start_attitude[k];
    }
    *state = c;
    return 0;
}

/* Set the attitude (quaternion, scalar last) that turns body z along `axis` (unit vector, ENU),
 * with body x at the azimuth `heading`. */
static void point(const double axis[3], double heading, double q[4])
{
    /* Upright with the heading: a rotation about up by `turn`. */
    double turn = 1.5707963267948966 - heading;
    double cz = cos(0.5 * turn), sz = sin(0.5 * turn);
    /* Shortest rotation from up to `axis`. */
    double w = sqrt(0.5 * (1.0 + axis[2]));
    double x = -axis[1] / (2.0 * w), y = axis[0] / (2.0 * w);
    q[0] = x * cz + y * sz;
    q[1] = y * cz - x * sz;
    q[2] = w * sz;
    q[3] = w * cz;
}

/* Compute the thrust acceleration of E-guidance to the point above the target. */
static void approach(const Computer *c, double left, double a[3])
{
    const double final[3] = {0.0, 0.0, -APPROACH_SPEED};
    left = fmax(left - c->lag, MIN_TIME_TO_GO);
    for (int k = 0; k < 3; k++) {
        double end = c->target[k] + (k == 2 ? c->com_height + APPROACH_HEIGHT : 0.0);
        double velocity = c->estimate.velocity[k];
        double miss = end - c->estimate.position[k] - c->lag * velocity - left * final[k];
        a[k] = (6.0 * miss / left + 4.0 * (final[k] - velocity)) / left;
    }
}

/* Compute the thrust acceleration of the vertical descent. */
static void descend(const Computer *c, double height, double a[3])
{
    double speed = height < SLOW_HEIGHT ? TOUCHDOWN_SPEED : APPROACH_SPEED;
    for (int k = 0; k < 2; k++) {
        double miss = c->target[k] - c->estimate.position[k];
        a[k] = 0.16 * miss - 0.7 * c->estimate.velocity[k];
    }
    a[2] = 1.2 * (-speed - c->estimate.velocity[2]);
}

int lunarsim_computer_step(void *state, const LunarsimMeasurements *input, LunarsimCommand *output)
{
    Computer *c = state;
    LunarsimEstimate *e = &c->estimate;
    double a[3], size = 0.0, limit, across;
    if (input->navigation_fix_count > 0) {
        const LunarsimNavigationFix *fix = &input->navigation_fix[0];
        for (int k = 0; k < 3; k++) {
            e->position[k] = fix->position[k];
            e->velocity[k] = fix->velocity[k];
        }
        for (int k = 0; k < 4; k++) {
            e->attitude[k] = fix->attitude[k];
        }
        for (int k = 0; k < 81; k++) {
            e->covariance[k / 9][k % 9] = fix->covariance[k / 9][k % 9];
        }
    }
    if (input->time > 0.0) {
        c->mass -= c->thrust * c->cycle / c->exhaust_velocity;
    }
    e->time = input->time;
    e->mass = c->mass;
    double left = c->arrival - input->time;
    double height = e->position[2] - c->target[2] - c->com_height;
    int is_vertical = left <= 0.0 || height < APPROACH_HEIGHT;
    if (is_vertical) {
        descend(c, height, a);
    } else {
        approach(c, left, a);
    }
    a[2] = fmax(a[2] + c->gravity, 0.3 * c->gravity);
    limit = a[2] * tan(is_vertical ? MAX_TILT_VERTICAL : MAX_TILT);
    across = hypot(a[0], a[1]);
    for (int k = 0; k < 2; k++) {
        a[k] *= across > limit ? limit / across : 1.0;
    }
    size = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    const double axis[3] = {a[0] / size, a[1] / size, a[2] / size};
    c->thrust = fmin(fmax(size * c->mass, c->thrust_min), c->thrust_max);
    output->thrust = c->thrust;
    point(axis, c->heading, output->attitude);
    output->estimate = *e;
    for (int k = 0; k < 3; k++) {
        output->site[k] = c->target[k];
    }
    output->time_to_go = fmax(left, 0.0);
    return 0;
}

void lunarsim_computer_close(void *state) { free(state); }
