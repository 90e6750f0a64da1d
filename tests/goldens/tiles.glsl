// shader 0 (vert)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
void main() {
    gl_Position = vec4(vec2((gl_VertexIndex << 1) & 2, gl_VertexIndex & 2) * 2.0 - 1.0, 0.0, 1.0);
}

// shader 1 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 40, (i) / 40))
layout(location = 0) out int o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int v0;
{ ivec2 size_ = ivec2(16, 16), lo_ = pixel * size_, hi_ = min(lo_ + size_, ivec2(40, 24));
    v0 = 0;
    for (int b_ = lo_.y; b_ < hi_.y && v0 == 0; ++b_)
    for (int a_ = lo_.x; a_ < hi_.x && v0 == 0; ++a_) v0 = T0(ivec2(a_, b_)) >= 0 ? 1 : 0; }
o0 = v0;
}

// shader 2 (vert)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) % 3, (i) / 3))
void main() {
int tile = gl_VertexIndex / 6, corner = gl_VertexIndex % 6;
ivec2 at = ivec2(tile % 3, tile / 3);
vec2 low = vec2(at * ivec2(16, 16)), high = min(low + vec2(16, 16), vec2(40, 24));
vec2 o = vec2(corner == 1 || corner == 3 || corner == 5 ? high.x : low.x, corner >= 2 && corner != 3 ? high.y : low.y);
gl_Position = T1(at) != 0 ? vec4(o / vec2(40, 24) * 2.0 - 1.0, 0.0, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);

}

// shader 3 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 40, (i) / 40))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0).xyz)
#define E2(i) T2(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out int o0;
layout(location = 1) out vec4 o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u0 = T0(pixel);
int v0;
v0 = u0 + 1;
int v1;
v1 = 1 != 0 ? v0 : int(0);
int v2;
v2 = int(v1 > 0);
float v3;
v3 = 1.0;
int v4;
v4 = v1 - 1;
vec3 v5;
v5 = vec3(0); if (v4 >= 0) v5 = E2(min(v4, 4 * 2 - 1));
vec3 v6;
{ vec3 e_ = exp(-abs(v5)); v6 = mix(e_, vec3(1.0), greaterThanEqual(v5, vec3(0.0))) / (1.0 + e_); }
vec3 v7;
v7 = v5 * 0.25;
vec3 v8;
{ vec3 e_ = exp(-abs(v7)); v8 = mix(e_, vec3(1.0), greaterThanEqual(v7, vec3(0.0))) / (1.0 + e_); }
vec3 v9;
v9 = v6 * v8;
vec3 v10;
v10 = v2 != 0 ? vec3(v9) : vec3(0.0);
vec3 v11;
v11 = v3 * v10;
vec3 v12;
v12 = v11 + v11;
vec3 v13;
v13 = v2 != 0 ? vec3(v12) : vec3(0.0);
vec3 v14;
v14 = v13 * v6;
vec3 v15;
v15 = v14 * v8;
vec3 v16;
v16 = -v7;
vec3 v17;
{ vec3 e_ = exp(-abs(v16)); v17 = mix(e_, vec3(1.0), greaterThanEqual(v16, vec3(0.0))) / (1.0 + e_); }
vec3 v18;
v18 = v15 * v17;
vec3 v19;
v19 = v18 * 0.25;
vec3 v20;
v20 = v13 * v8;
vec3 v21;
v21 = v20 * v6;
vec3 v22;
v22 = -v5;
vec3 v23;
{ vec3 e_ = exp(-abs(v22)); v23 = mix(e_, vec3(1.0), greaterThanEqual(v22, vec3(0.0))) / (1.0 + e_); }
vec3 v24;
v24 = v21 * v23;
vec3 v25;
v25 = v19 + v24;
o0 = v1;
o1 = vec4(v25, 0);
}

// shader 4 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xyz)
#define E0(i) T0(ivec2((i) % 40, (i) / 40))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) % 40, (i) / 40))
layout(set = 0, binding = 2) uniform itexture2D t2;
#define T2(c) (texelFetch(t2, c, 0))
#define E2(i) T2(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0))
#define E3(i) T3(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 4) uniform texture2D t4;
#define T4(c) (texelFetch(t4, c, 0).xy)
#define E4(i) T4(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out vec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec4 u2 = T2(pixel);
vec4 u3 = T3(pixel);
vec2 u4 = T4(pixel);
vec3 v0 = vec3(0);
{ vec2 d_ = u3.zw - u3.xy;
bool level_ = abs(d_.y) < 0.25;
float slope_ = level_ ? 0.0 : d_.x / d_.y, wide_ = level_ ? 1e6 : float(99.0) * length(d_) / abs(d_.y) + 0.02 + 2e-3 * abs(slope_);
ivec4 box_ = clamp(u2, ivec4(0), ivec4(40, 24, 40, 24)), named_ = ivec4(0);
ivec2 q_ = ivec2(0, box_.y - 1);
int end_ = 0;
for (;;) {
bool hit_ = false;
for (bool left_ = true; left_ && !hit_;) {
if (++q_.x >= end_) {
left_ = ++q_.y < box_.w;
float at_ = u4.x + u3.x + (float(q_.y) + 0.5 - u4.y - u3.y) * slope_ - 0.5;
ivec2 row_ = ivec2(clamp(vec2(ceil(at_ - wide_), floor(at_ + wide_) + 1.0), vec2(box_.xx), vec2(box_.zz)));
q_.x = row_.x;
end_ = row_.y;
}
hit_ = left_ && q_.x < end_;
named_ = ivec4(T1(hit_ ? q_ : ivec2(0)));
hit_ = hit_ && any(equal(named_, ivec4((pixel.y * 4 + pixel.x) + 1)));
}
if (!hit_) break; if (named_[0] == (pixel.y * 4 + pixel.x) + 1) v0 += T0(q_); } }
o0 = vec4(v0, 0);
}
