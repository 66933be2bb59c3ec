#ifdef HOLES
in float hole;
#endif

void main() {
#ifdef HOLES
    if (hole > 0.0) discard;
#endif
}
