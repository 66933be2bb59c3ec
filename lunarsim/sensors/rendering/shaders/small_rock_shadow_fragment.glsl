flat in float depth;
layout(location = 0) out float dark;

void main() {
    dark = depth;
}
