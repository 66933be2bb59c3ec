/* E-guidance as an FMU for co-simulation: FMI 2.0, or with -DFMI3 FMI 3.0 with arrays.
 *
 * The value reference of a variable is its index in `v`: 0 gravity, 1 lag, 2 time_to_go,
 * 3 estimate.position, 6 estimate.velocity, 9 end.position, 12 end.velocity, 15 acceleration. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#ifdef FMI3
#include "fmi3Functions.h"
#else
#include "fmi2Functions.h"
#endif

typedef struct {
    double v[18];
} Unit;

static int step(Unit *u)
{
    double left = u->v[2] - u->v[1];
    left = left < 1.5 ? 1.5 : left;
    for (int k = 0; k < 3; k++) {
        double ahead = u->v[3 + k] + u->v[1] * u->v[6 + k];
        double miss = u->v[9 + k] - ahead - left * u->v[12 + k];
        u->v[15 + k] = (6.0 * miss / left + 4.0 * (u->v[12 + k] - u->v[6 + k])) / left;
    }
    u->v[17] += u->v[0];
    return isfinite(u->v[15]) ? 0 : 1;
}

#ifdef FMI3
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference refs[],
    size_t count, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events;
    (void)early, (void)refs, (void)count, (void)environment, (void)log, (void)update;
    return calloc(1, sizeof(Unit));
}
void fmi3FreeInstance(fmi3Instance u) { free(u); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance u, fmi3Boolean a, fmi3Float64 b, fmi3Float64 c,
                                       fmi3Boolean d, fmi3Float64 e)
{
    (void)u, (void)a, (void)b, (void)c, (void)d, (void)e;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance u) { (void)u; return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance u) { (void)u; return fmi3OK; }
fmi3Status fmi3SetFloat64(fmi3Instance u, const fmi3ValueReference refs[], size_t count,
                          const fmi3Float64 values[], size_t size)
{
    (void)count;
    memcpy(((Unit *)u)->v + refs[0], values, size * sizeof *values);
    return fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance u, const fmi3ValueReference refs[], size_t count,
                          fmi3Float64 values[], size_t size)
{
    (void)count;
    memcpy(values, ((Unit *)u)->v + refs[0], size * sizeof *values);
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance u, fmi3Float64 time, fmi3Float64 period, fmi3Boolean noSet,
                      fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)noSet;
    *event = *end = *early = fmi3False;
    *last = time + period;
    return step(u) ? fmi3Error : fmi3OK;
}
#else
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)resources, (void)functions, (void)visible;
    (void)logging;
    return calloc(1, sizeof(Unit));
}
void fmi2FreeInstance(fmi2Component u) { free(u); }
fmi2Status fmi2SetupExperiment(fmi2Component u, fmi2Boolean a, fmi2Real b, fmi2Real c,
                               fmi2Boolean d, fmi2Real e)
{
    (void)u, (void)a, (void)b, (void)c, (void)d, (void)e;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component u) { (void)u; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component u) { (void)u; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component u) { (void)u; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component u, const fmi2ValueReference refs[], size_t count,
                       const fmi2Real values[])
{
    for (size_t k = 0; k < count; k++) {
        ((Unit *)u)->v[refs[k]] = values[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component u, const fmi2ValueReference refs[], size_t count,
                       fmi2Real values[])
{
    for (size_t k = 0; k < count; k++) {
        values[k] = ((Unit *)u)->v[refs[k]];
    }
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component u, fmi2Real time, fmi2Real period, fmi2Boolean noSet)
{
    (void)time, (void)period, (void)noSet;
    return step(u) ? fmi2Error : fmi2OK;
}
#endif
