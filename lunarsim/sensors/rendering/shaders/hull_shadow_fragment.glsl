// Upside down, so that the ray comes from the Sun; t is the way down from the rock's base.
flat in vec4 face[FACES];   // t at the rock's axis and its slopes, as (slopes, t, 1 at the far side)
noperspective in vec2 place;
flat in vec2 depth;
layout(location = 0) out float dark;

void main() {
    float enter = -1e30, leave = 1e30;
    for (int k = 0; k < FACES; k++) {
        float t = dot(face[k].xy, place) + face[k].z;
        if (face[k].w > 0.0) leave = min(leave, t);
        else enter = max(enter, t);
    }
    if (enter > leave) discard;
    dark = clamp(depth.x + depth.y * leave, 0.0, 1.0);
}
