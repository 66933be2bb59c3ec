// A rock that is the convex intersection of a few half spaces.
flat in vec4 face[FACES];   // normal over the scale, and distance of the plane from the camera
noperspective in vec3 ray;
flat in vec3 depth;
flat in float identity;
flat in Light light;
#ifdef BOULDERS
flat in float brightness;
#endif

void main() {
    float enter = -1e30, leave = 1e30;
    vec3 normal = vec3(0.0);
    for (int k = 0; k < FACES; k++) {
        float speed = dot(face[k].xyz, ray);
        // Parallel to a plane: the crossing is far behind if the ray is outside, far ahead if inside.
        if (abs(speed) < 1e-12) speed = 1e-12;
        float t = face[k].w / speed;
        if (speed > 0.0) {
            leave = min(leave, t);
        } else if (t > enter) {
            enter = t;
            normal = face[k].xyz;
        }
    }
    if (enter > leave || enter < depth.z) discard;
    gl_FragDepth = depth.x - depth.y / enter;
    normal = normalize(normal);
    vec3 rel = enter * ray;
    paint(STONE(light, rel, normal), normal, length(rel), identity);
}
