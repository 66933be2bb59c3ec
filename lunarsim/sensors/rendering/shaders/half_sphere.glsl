const float NEVER = 1e30;

// Distances t at which the line o + t d enters (x) and leaves (y) the unit hemisphere extended
// downwards by a cylinder; x > y: no intersection.
vec2 cross_half_sphere(vec3 o, vec3 d) {
    // Start from the point nearest to the centre, for precision at long range.
    float dd = dot(d, d);
    float tc = -dot(o, d) / dd;
    vec3 near = o + tc * d;
    float room = 1.0 - dot(near, near);
    float enter = NEVER, leave = -NEVER;
    if (room > 0.0) {
        float half_chord = sqrt(room / dd);
        if (o.z + (tc - half_chord) * d.z >= 0.0) enter = tc - half_chord;
        if (o.z + (tc + half_chord) * d.z >= 0.0) leave = tc + half_chord;
    }
    if (enter == NEVER || leave == -NEVER) {
        // The extension below the base: a unit cylinder.
        float ff = dot(d.xy, d.xy);
        if (ff > 0.0) {
            float tw = -dot(near.xy, d.xy) / ff;
            vec2 foot = near.xy + tw * d.xy;
            float gap = 1.0 - dot(foot, foot);
            if (gap > 0.0) {
                float half_width = sqrt(gap / ff);
                float first = tc + tw - half_width, last = tc + tw + half_width;
                if (enter == NEVER && o.z + first * d.z < 0.0) enter = first;
                if (leave == -NEVER && o.z + last * d.z < 0.0) leave = last;
            }
        }
    }
    // Rounding may place a point of the rim neither above nor below the base.
    if (room > 0.0 && enter == NEVER && leave != -NEVER) enter = tc - sqrt(room / dd);
    if (room > 0.0 && leave == -NEVER && enter != NEVER) leave = tc + sqrt(room / dd);
    return vec2(enter, leave);
}
