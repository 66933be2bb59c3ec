// Policy in C++17: the nearest cell of the hazard map that is safe with its neighbourhood.
//
// cmake -S . -B build && cmake --build build
// lunarsim fly golombek --set policy.kind=library --set policy.path=build/nearest_safe.so
//     --set policy.configuration=0.9 --allow-program build/nearest_safe.so
//
// A cell counts if p_safe reaches the threshold in the cell and in all cells around it. The
// configuration is the threshold. nearest_safe.py is the same policy in Python.
#include "lunarsim.h"

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>

namespace {

// Maximum horizontal distance of a new site, m.
constexpr double kMaxDistance = 60.0;

class NearestSafe {
public:
    explicit NearestSafe(double threshold) : threshold_(threshold) {}

    void decide(const LunarsimPolicyInput &input, LunarsimPolicyOutput &output) const
    {
        output.action = LUNARSIM_POLICY_ACTION_KEEP;
        if (input.site_p_safe >= threshold_) {
            std::strcpy(output.reason, "the site is safe");
            return;
        }
        const LunarsimHazardMap &map = input.map;
        double nearest = kMaxDistance * kMaxDistance;
        for (std::uint32_t row = 1; row + 1 < map.grid.rows; ++row) {
            for (std::uint32_t col = 1; col + 1 < map.grid.cols; ++col) {
                const double x = map.grid.x0 + col * map.grid.posting;
                const double y = map.grid.y0 + row * map.grid.posting;
                const double east = x - input.site[0], north = y - input.site[1];
                const double distance = east * east + north * north;
                if (distance < nearest && is_safe(map, row, col)) {
                    nearest = distance;
                    output.action = LUNARSIM_POLICY_ACTION_DIVERT;
                    output.site[0] = x;
                    output.site[1] = y;
                    output.site[2] = height(map, row, col, input.site[2]);
                }
            }
        }
        const bool is_found = output.action == LUNARSIM_POLICY_ACTION_DIVERT;
        if (is_found && nearest < map.grid.posting * map.grid.posting) {
            output.action = LUNARSIM_POLICY_ACTION_KEEP; // the site is in this cell or beside it
        }
        std::strcpy(output.reason, is_found ? "nearest safe cell" : "no safe cell");
    }

private:
    bool is_safe(const LunarsimHazardMap &map, std::uint32_t row, std::uint32_t col) const
    {
        for (std::uint32_t i = row - 1; i <= row + 1; ++i) {
            for (std::uint32_t j = col - 1; j <= col + 1; ++j) {
                if (map.p_safe[i * map.grid.cols + j] < threshold_) {
                    return false;
                }
            }
        }
        return true;
    }

    static double height(const LunarsimHazardMap &map, std::uint32_t row, std::uint32_t col,
                         double otherwise)
    {
        if (map.elevation_count == 0) {
            return otherwise;
        }
        const double known = map.elevation[row * map.grid.cols + col];
        return known == known ? known : otherwise; // NaN where unknown
    }

    double threshold_;
};

} // namespace

extern "C" {

std::uint32_t lunarsim_interface_version(void) { return LUNARSIM_INTERFACE_VERSION; }

int lunarsim_policy_init(const LunarsimBriefing *briefing, void **state)
{
    const double threshold = briefing->configuration[0] ? std::atof(briefing->configuration) : 0.9;
    if (!(threshold > 0.0 && threshold < 1.0)) {
        std::fprintf(stderr, "nearest_safe: the threshold must be between 0 and 1\n");
        return 1;
    }
    *state = std::make_unique<NearestSafe>(threshold).release();
    return 0;
}

int lunarsim_policy_step(void *state, const LunarsimPolicyInput *input,
                         LunarsimPolicyOutput *output)
{
    static_cast<const NearestSafe *>(state)->decide(*input, *output);
    return 0;
}

void lunarsim_policy_close(void *state) { delete static_cast<NearestSafe *>(state); }

} // extern "C"
