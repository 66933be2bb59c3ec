flat in float depth;
flat in float shade;
#ifdef TRUTH
flat in vec3 normal;
flat in vec2 range_and_number;
#endif

void main() {
    gl_FragDepth = depth;
#ifdef TRUTH
    paint(shade, normal, range_and_number.x, range_and_number.y);
#else
    paint(shade, vec3(0.0), 0.0, 0.0);
#endif
}
