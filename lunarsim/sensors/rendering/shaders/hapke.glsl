// Radiance factor I/F of Hapke's model, with the names of lunarsim.world.photometry.
const float TAN_ROUGH = HAPKE_TAN;
const float CHI = inversesqrt(1.0 + 3.14159265 * TAN_ROUGH * TAN_ROUGH);
const float GAMMA = sqrt(1.0 - HAPKE_W);
const float R0 = (1.0 - GAMMA) / (1.0 + GAMMA);

float lobe(float x) {
    float y = 1.0 + HAPKE_B * HAPKE_B - x;
    return (1.0 - HAPKE_B * HAPKE_B) * inversesqrt(y) / y;
}

float h_function(float x) {
    return 1.0 / (1.0 - HAPKE_W * x * (R0 + 0.5 * (1.0 - 2.0 * R0 * x) * log((1.0 + x) / x)));
}

float reflect_sun(Light light, vec3 n, vec3 towards_camera) {
    float incidence = dot(n, light.to_sun);
    if (incidence <= 0.0) return 0.0;
    vec2 mu = vec2(max(incidence, 1e-4), max(dot(n, towards_camera), 1e-4));
    float cos_g = dot(light.to_sun, towards_camera);
    vec2 sine = sqrt(max(1.0 - mu * mu, 1e-6));
    float cos_psi = clamp((cos_g - mu.x * mu.y) / (sine.x * sine.y), -1.0, 1.0);
    float half_psi = 0.5 - 0.5 * cos_psi;
    float f = exp(-2.0 * sqrt(half_psi / max(1.0 - half_psi, 1e-6)));
    vec2 q = mu / (sine * TAN_ROUGH);
    vec2 e1 = exp(-0.63661977 * q), e2 = exp(-0.31830989 * q * q);
    bool low = mu.x >= mu.y;
    // The direction nearer to the normal comes first.
    vec2 one = low ? e1 : e1.yx, two = low ? e2 : e2.yx;
    float below = 1.0 / (2.0 - one.y - angle_of(cos_psi) * 0.31830989 * one.x);
    vec2 more = vec2(cos_psi * two.y + half_psi * two.x, two.y - half_psi * two.x) * below;
    vec2 rough = CHI * (mu + sine * TAN_ROUGH * (low ? more : more.yx));
    vec2 over_eta = mu / (CHI * (mu + sine * TAN_ROUGH * e2 / (2.0 - e1)));
    float near = low ? over_eta.x : over_eta.y;
    float share = rough.y / mu.y * over_eta.y * over_eta.x * CHI / (1.0 - f + f * CHI * near);
    float half_g = sqrt(max(1.0 - cos_g, 0.0) / max(1.0 + cos_g, 1e-6));
    float single = 0.5 * ((1.0 + HAPKE_C) * lobe(2.0 * HAPKE_B * cos_g)
                          + (1.0 - HAPKE_C) * lobe(-2.0 * HAPKE_B * cos_g));
    single *= 1.0 + HAPKE_SURGE / (1.0 + half_g / HAPKE_WIDTH);
    float several = h_function(rough.x) * h_function(rough.y) - 1.0;
    return 0.25 * HAPKE_W * rough.x / (rough.x + rough.y) * (single + several) * share;
}
