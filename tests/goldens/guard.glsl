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
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u1 = T1(pixel);
if (u1 == 0) discard;
float u0 = T0(pixel);
float v0;
v0 = u0 * 2.0;
float v1;
{ float e_ = exp(-abs(v0)); v1 = (v0 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
float v2;
v2 = v1 * 2.0;
float v3;
{ float e_ = exp(-abs(v2)); v3 = (v2 >= 0.0 ? 1.0 : e_) / (1.0 + e_); }
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
v40 = u1 != 0 ? float(v39) : float(0.0);
o0 = v40;
}
