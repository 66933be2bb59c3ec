flat in float depth;
#ifdef STONE
flat in vec4 met;
layout(location = 0) out vec4 normal_and_number;
#endif

void main() {
    gl_FragDepth = depth;
#ifdef STONE
    normal_and_number = met;
#endif
}
