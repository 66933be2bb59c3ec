// The light as it is given. Fragment shaders get it as flat varyings: a software driver loads those
// many times faster than uniforms.
uniform vec3 sunlight;
uniform mat3x2 shadow_axes;
uniform vec2 shadow_corner;
uniform vec2 shadow_size;    // texels
uniform vec2 shadow_texel;   // in the texture that holds them
uniform vec2 shadow_depth;
uniform float albedo;
uniform float ambient;       // radiance factor of an unlit surface over the albedo
uniform float mcewen;        // 0 Lambert, 1 McEwen's lunar-Lambert

Light given_light() {
    vec2 e = shadow_axes[0], n = shadow_axes[1], up = shadow_axes[2];
    return Light(
        sunlight, vec4(e.x, n.x, up.x, shadow_corner.x), vec4(e.y, n.y, up.y, shadow_corner.y),
        vec4(shadow_size - 2.0, shadow_texel), shadow_depth, vec3(albedo, albedo * ambient, mcewen)
    );
}
