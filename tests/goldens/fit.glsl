// shader 0 (vert)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
void main() {
    gl_Position = vec4(vec2((gl_VertexIndex << 1) & 2, gl_VertexIndex & 2) * 2.0 - 1.0, 0.0, 1.0);
}

// shader 1 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xyz)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec3 u0 = T0(pixel);
vec3 v0;
{ vec3 e_ = exp(-abs(u0)); v0 = mix(e_, vec3(1.0), greaterThanEqual(u0, vec3(0.0))) / (1.0 + e_); }
vec3 v1;
{ vec3 e_ = exp(-abs(v0)); v1 = mix(e_, vec3(1.0), greaterThanEqual(v0, vec3(0.0))) / (1.0 + e_); }
vec3 v2;
{ vec3 e_ = exp(-abs(v1)); v2 = mix(e_, vec3(1.0), greaterThanEqual(v1, vec3(0.0))) / (1.0 + e_); }
o0 = vec4(v2, 0);
}

// shader 2 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xyz)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0).xyz)
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec3 u0 = T0(pixel);
vec3 u1 = T1(pixel);
float v0;
v0 = 0.010416666977107525;
vec3 v1;
{ vec3 e_ = exp(-abs(u0)); v1 = mix(e_, vec3(1.0), greaterThanEqual(u0, vec3(0.0))) / (1.0 + e_); }
vec3 v2;
v2 = v1 - u1;
vec3 v3;
v3 = v0 * v2;
vec3 v4;
v4 = v3 + v3;
vec3 v5;
v5 = v4 * v1;
vec3 v6;
v6 = -u0;
vec3 v7;
{ vec3 e_ = exp(-abs(v6)); v7 = mix(e_, vec3(1.0), greaterThanEqual(v6, vec3(0.0))) / (1.0 + e_); }
vec3 v8;
v8 = v5 * v7;
vec3 v9;
v9 = v8 * 0.10000000149011612;
vec3 v10;
v10 = u0 - v9;
o0 = vec4(v10, 0);
}

// shader 3 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xyz)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0).xyz)
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec3 u0 = T0(pixel);
vec3 u1 = T1(pixel);
vec3 v0;
{ vec3 e_ = exp(-abs(u0)); v0 = mix(e_, vec3(1.0), greaterThanEqual(u0, vec3(0.0))) / (1.0 + e_); }
vec3 v1;
v1 = v0 - u1;
float v2;
v2 = dot(v1, v1);
o0 = v2;
}

// shader 4 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
float v0 = float(0);
for (int b_ = pixel.y * 8; b_ < min(pixel.y * 8 + 8, 8); ++b_) for (int a_ = pixel.x * 12; a_ < min(pixel.x * 12 + 12, 12); ++a_) if (b_ * 12 + a_ < 96) { v0 += T0(ivec2(a_, b_)); }
float v1;
v1 = v0 * 0.010416666977107525;
o0 = v1;
}
