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
#define E0(i) T0(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out int o0;
layout(location = 1) out int o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int v0 = int(0);
for (int k_ = 0; k_ < min((pixel.y * 2 + pixel.x) * 64 + 64, 90); ++k_) { v0 += E0(k_) * 1; }
int v1;
v1 = v0 / 1;
o0 = v0;
o1 = v1;
}

// shader 2 (vert)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 3) uniform itexture2D t3;
#define T3(c) (texelFetch(t3, c, 0).x)
#define E3(i) T3(ivec2(i, 0))
void main() {
int corner = gl_VertexIndex % 6, full = T3(ivec2(1, 0)) / (4 * 23), rest = T3(ivec2(1, 0)) - full * 4 * 23;
bool last = gl_VertexIndex >= 6;
vec2 low = vec2(last ? full * 4 : 0, 0);
vec2 high = vec2((last ? full + 1 : full) * 4, last ? (rest + 4 - 1) / 4 : 23);
vec2 o = vec2(corner == 1 || corner == 3 || corner == 5 ? high.x : low.x, corner >= 2 && corner != 3 ? high.y : low.y);
gl_Position = vec4(o / vec2(4, 23) * 2.0 - 1.0, 0.0, 1.0);

}

// shader 3 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2(i, 0))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0).x)
#define E2(i) T2(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out int o0;
layout(location = 1) out float o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 v0;
v0 = ivec2(-1, 0);
{ int s_ = (pixel.y * 4 + pixel.x) * 1, end_ = s_ < T0(ivec2(2 - 1, 1 - 1)) ? 2 : 0, before_ = 0, k_ = 0;
  for (; k_ < end_; ++k_) { int c_ = E0(k_); if (s_ < c_) break; before_ = c_; }
  if (end_ > 0) v0 = ivec2(k_, (s_ - before_) / 1); }
ivec2 v1;
{ int k_ = v0.x * 64, end_ = v0.x < 0 ? k_ : min(k_ + 64, 90), rest_ = v0.y;
  for (; k_ < end_; ++k_) { int c_ = E1(k_); if (rest_ < c_) break; rest_ -= c_; }
  v1 = v0.x < 0 ? ivec2(-1, 0) : ivec2(k_, rest_); }
int v2;
v2 = v1.x;
float v3;
v3 = float(0); if (v2 >= 0) v3 = E2(min(v2, 4 * 23 - 1));
float v4;
v4 = v3 * 2.0;
float v5;
{ float e_ = exp(-abs(v4)); v5 = (v4 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v6;
v6 = v5 * 2.0;
float v7;
{ float e_ = exp(-abs(v6)); v7 = (v6 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v8;
v8 = v7 * 2.0;
float v9;
{ float e_ = exp(-abs(v8)); v9 = (v8 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v10;
v10 = v9 * 2.0;
float v11;
{ float e_ = exp(-abs(v10)); v11 = (v10 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v12;
v12 = v11 * 2.0;
float v13;
{ float e_ = exp(-abs(v12)); v13 = (v12 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v14;
v14 = v13 * 2.0;
float v15;
{ float e_ = exp(-abs(v14)); v15 = (v14 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v16;
v16 = v15 * 2.0;
float v17;
{ float e_ = exp(-abs(v16)); v17 = (v16 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v18;
v18 = v17 * 2.0;
float v19;
{ float e_ = exp(-abs(v18)); v19 = (v18 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v20;
v20 = v19 * 2.0;
float v21;
{ float e_ = exp(-abs(v20)); v21 = (v20 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v22;
v22 = v21 * 2.0;
float v23;
{ float e_ = exp(-abs(v22)); v23 = (v22 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v24;
v24 = v23 * 2.0;
float v25;
{ float e_ = exp(-abs(v24)); v25 = (v24 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v26;
v26 = v25 * 2.0;
float v27;
{ float e_ = exp(-abs(v26)); v27 = (v26 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v28;
v28 = v27 * 2.0;
float v29;
{ float e_ = exp(-abs(v28)); v29 = (v28 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v30;
v30 = v29 * 2.0;
float v31;
{ float e_ = exp(-abs(v30)); v31 = (v30 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v32;
v32 = v31 * 2.0;
float v33;
{ float e_ = exp(-abs(v32)); v33 = (v32 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v34;
v34 = v33 * 2.0;
float v35;
{ float e_ = exp(-abs(v34)); v35 = (v34 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v36;
v36 = v35 * 2.0;
float v37;
{ float e_ = exp(-abs(v36)); v37 = (v36 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v38;
v38 = v37 * 2.0;
float v39;
{ float e_ = exp(-abs(v38)); v39 = (v38 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v40;
v40 = v39 * 2.0;
float v41;
{ float e_ = exp(-abs(v40)); v41 = (v40 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v42;
v42 = v41 * 2.0;
float v43;
{ float e_ = exp(-abs(v42)); v43 = (v42 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
o0 = v2;
o1 = v43;
}

// shader 4 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 2) uniform itexture2D t2;
#define T2(c) (texelFetch(t2, c, 0).x)
#define E2(i) T2(ivec2(i, 0))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0).x)
#define E3(i) T3(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u0 = T0(pixel);
int v0;
{ int low_ = 0, high_ = u0 != 0 ? T2(ivec2(2 - 1, 1 - 1)) / 1 : 0;
  while (low_ < high_) { int mid_ = (low_ + high_) >> 1; if (E1(mid_) < (pixel.y * 4 + pixel.x)) low_ = mid_ + 1; else high_ = mid_; }
  v0 = u0 != 0 ? low_ : -1; }
float v1;
v1 = float(0); if (v0 >= 0) v1 = E3(min(v0, 4 * 23 - 1));
float v2;
v2 = u0 != 0 ? float(v1) : float(0.0);
o0 = v2;
}

// shader 5 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
float v0 = float(0);
for (int b_ = pixel.y * 23; b_ < min(pixel.y * 23 + 23, 23); ++b_) for (int a_ = pixel.x * 4; a_ < min(pixel.x * 4 + 4, 4); ++a_) if (b_ * 4 + a_ < 90) { v0 += T0(ivec2(a_, b_)); }
o0 = v0;
}
