// A rock: a scaled, turned unit shape, as in lunarsim.terrain.
uniform sampler2D rocks;    // three texels a rock: (x, y, base, a), (b, height, cos, sin), (shape)
uniform vec4 planes[18 * MOST];   // half spaces of the unit shapes, MOST to each
uniform int faces[32];      // number of half spaces of each shape, 0 for the half sphere
uniform vec3 eye;           // camera, in the axes of the rocks

struct Rock { vec3 centre; vec3 scale; vec2 turn; int shape; };

Rock rock_of(int n) {
    ivec2 at = ivec2((n % 1024) * 3, n / 1024);
    vec4 one = texelFetch(rocks, at, 0);
    vec4 two = texelFetch(rocks, at + ivec2(1, 0), 0);
    float three = texelFetch(rocks, at + ivec2(2, 0), 0).r;
    return Rock(one.xyz - eye, vec3(one.w, two.xy), two.zw, int(three));
}

vec3 to_unit(Rock r, vec3 v) {
    return vec3(r.turn.x * v.x + r.turn.y * v.y, r.turn.x * v.y - r.turn.y * v.x, v.z) / r.scale;
}

vec3 unit_normal_to_enu(Rock r, vec3 n) {
    n /= r.scale;
    return normalize(vec3(r.turn.x * n.x - r.turn.y * n.y, r.turn.y * n.x + r.turn.x * n.y, n.z));
}

const float NEVER = 1e30;

// Where the line o + t d enters (x) and leaves (y) the shape carried straight down; x > y: nowhere.
vec2 cross_rock(Rock r, vec3 o, vec3 d, out vec3 normal) {
    normal = vec3(0.0);
    if (faces[r.shape] == 0) {
        // From the point nearest to the axis on: this keeps precision far away.
        float dd = dot(d, d);
        float tc = -dot(o, d) / dd;
        vec3 near = o + tc * d;
        float room = 1.0 - dot(near, near);
        float enter = NEVER, leave = -NEVER;
        if (room > 0.0) {
            float half_chord = sqrt(room / dd);
            if (o.z + (tc - half_chord) * d.z >= 0.0) enter = tc - half_chord;
            if (o.z + (tc + half_chord) * d.z >= 0.0) leave = tc + half_chord;
        }
        if (enter == NEVER || leave == -NEVER) {
            // The skirt below the base: a unit cylinder.
            float ff = dot(d.xy, d.xy);
            if (ff > 0.0) {
                float tw = -dot(near.xy, d.xy) / ff;
                vec2 foot = near.xy + tw * d.xy;
                float gap = 1.0 - dot(foot, foot);
                if (gap > 0.0) {
                    float half_width = sqrt(gap / ff);
                    float first = tc + tw - half_width, last = tc + tw + half_width;
                    if (enter == NEVER && o.z + first * d.z < 0.0) enter = first;
                    if (leave == -NEVER && o.z + last * d.z < 0.0) leave = last;
                }
            }
        }
        // Rounding may find a point on the rim neither above the base nor below it.
        if (room > 0.0 && enter == NEVER && leave != -NEVER) enter = tc - sqrt(room / dd);
        if (room > 0.0 && leave == -NEVER && enter != NEVER) leave = tc + sqrt(room / dd);
        normal = o + enter * d;
        normal.z = max(normal.z, 0.0);
        return vec2(enter, leave);
    }
    float enter = -NEVER, leave = NEVER;
    for (int k = 0; k < faces[r.shape]; k++) {
        vec4 face = planes[r.shape * MOST + k];
        float speed = dot(face.xyz, d);
        float room = face.w - dot(face.xyz, o);
        if (speed < 0.0) {
            float t = room / speed;
            if (t > enter) { enter = t; normal = face.xyz; }
        } else if (speed > 0.0) {
            leave = min(leave, room / speed);
        } else if (room < 0.0) {
            enter = NEVER;
        }
    }
    return vec2(enter, leave);
}
