// Light parameters from the frame block. Fragment shaders receive them as a flat varying, which a
// software driver loads many times faster than uniforms.
Light given_light() {
    return Light(
        sunlight.xyz, across, along, vec4(map_size - 2.0, map_texel), map_dark, surface.xyz
#ifdef WIDE
        , penumbra
#endif
#ifdef GLOW
        , glow_from
#endif
    );
}
