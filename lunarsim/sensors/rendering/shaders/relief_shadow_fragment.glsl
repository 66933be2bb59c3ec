#ifdef HOLES
in float hole;
#endif
layout(location = 0) out float dark;

void main() {
#ifdef HOLES
    if (hole > 0.0) discard;
#endif
    dark = gl_FragCoord.z;
}
