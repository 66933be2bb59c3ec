flat in vec3 fixed_part;           // camera position, in units of the rock
noperspective in vec3 moving_part; // ray direction, in units of the rock
flat in vec4 turn_and_scale;
flat in float height;
flat in vec3 depth;
flat in float identity;
flat in Light light;
#ifdef BOULDERS
flat in float brightness;
#endif
noperspective in vec3 ray;

void main() {
    vec2 t = cross_half_sphere(fixed_part, moving_part);
    if (t.x > t.y || t.x < depth.z) discard;
    gl_FragDepth = depth.x - depth.y / t.x;
    vec3 n = fixed_part + t.x * moving_part;
    n.z = max(n.z, 0.0);
    n /= vec3(turn_and_scale.zw, height);
    vec2 turn = turn_and_scale.xy;
    n = normalize(vec3(turn.x * n.x - turn.y * n.y, turn.y * n.x + turn.x * n.y, n.z));
    vec3 rel = t.x * ray;
    paint(STONE(light, rel, n), n, length(rel), identity);
}
