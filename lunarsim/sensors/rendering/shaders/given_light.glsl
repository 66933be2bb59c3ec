// The light as it is given. Fragment shaders get it as a flat varying: a software driver loads those
// many times faster than uniforms.
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
