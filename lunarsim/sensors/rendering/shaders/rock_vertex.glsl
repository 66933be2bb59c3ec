in vec4 box;     // least and greatest pixel of the rock, x and y
in int number;
uniform vec2 image;
flat out int rock;

void main() {
    vec2 corner = vec2(gl_VertexID % 2, gl_VertexID / 2);
    vec2 pixel = mix(box.xy, box.zw, corner);
    rock = number;
    gl_Position = vec4((2.0 * pixel + 1.0) / image - 1.0, 0.0, 1.0);
}
