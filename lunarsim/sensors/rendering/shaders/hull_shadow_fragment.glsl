// The ray points away from the Sun; t is the height that it descends from the rock's base.
flat in vec4 face[FACES];   // gradient of t in the ray's position, t at the rock's axis, sign: 1 if leaving
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
