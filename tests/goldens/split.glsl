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
#define T0(c) (texelFetch(t0, c, 0))
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0))
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0))
#define E2(i) T2(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0))
#define E3(i) T3(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 4) uniform texture2D t4;
#define T4(c) (texelFetch(t4, c, 0))
#define E4(i) T4(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 5) uniform texture2D t5;
#define T5(c) (texelFetch(t5, c, 0))
#define E5(i) T5(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 6) uniform texture2D t6;
#define T6(c) (texelFetch(t6, c, 0))
#define E6(i) T6(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 7) uniform texture2D t7;
#define T7(c) (texelFetch(t7, c, 0))
#define E7(i) T7(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 8) uniform texture2D t8;
#define T8(c) (texelFetch(t8, c, 0))
#define E8(i) T8(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 9) uniform texture2D t9;
#define T9(c) (texelFetch(t9, c, 0))
#define E9(i) T9(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 10) uniform texture2D t10;
#define T10(c) (texelFetch(t10, c, 0))
#define E10(i) T10(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 11) uniform texture2D t11;
#define T11(c) (texelFetch(t11, c, 0))
#define E11(i) T11(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 12) uniform texture2D t12;
#define T12(c) (texelFetch(t12, c, 0))
#define E12(i) T12(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 13) uniform texture2D t13;
#define T13(c) (texelFetch(t13, c, 0))
#define E13(i) T13(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 14) uniform texture2D t14;
#define T14(c) (texelFetch(t14, c, 0))
#define E14(i) T14(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 15) uniform texture2D t15;
#define T15(c) (texelFetch(t15, c, 0))
#define E15(i) T15(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec4 u0 = T0(pixel);
vec4 u1 = T1(pixel);
vec4 u2 = T2(pixel);
vec4 u3 = T3(pixel);
vec4 u4 = T4(pixel);
vec4 u5 = T5(pixel);
vec4 u6 = T6(pixel);
vec4 u7 = T7(pixel);
vec4 u8 = T8(pixel);
vec4 u9 = T9(pixel);
vec4 u10 = T10(pixel);
vec4 u11 = T11(pixel);
vec4 u12 = T12(pixel);
vec4 u13 = T13(pixel);
vec4 u14 = T14(pixel);
vec4 u15 = T15(pixel);
vec4 v0;
v0 = u0 * u1;
vec4 v1;
v1 = v0 + u1;
vec4 v2;
{ vec4 e_ = exp(-abs(v1)); v2 = mix(e_, vec4(1.0), greaterThanEqual(v1, vec4(0.0))) / (1.0 + e_); }
vec4 v3;
v3 = v2 * u2;
vec4 v4;
v4 = v3 + u2;
vec4 v5;
{ vec4 e_ = exp(-abs(v4)); v5 = mix(e_, vec4(1.0), greaterThanEqual(v4, vec4(0.0))) / (1.0 + e_); }
vec4 v6;
v6 = v5 * u3;
vec4 v7;
v7 = v6 + u3;
vec4 v8;
{ vec4 e_ = exp(-abs(v7)); v8 = mix(e_, vec4(1.0), greaterThanEqual(v7, vec4(0.0))) / (1.0 + e_); }
vec4 v9;
v9 = v8 * u4;
vec4 v10;
v10 = v9 + u4;
vec4 v11;
{ vec4 e_ = exp(-abs(v10)); v11 = mix(e_, vec4(1.0), greaterThanEqual(v10, vec4(0.0))) / (1.0 + e_); }
vec4 v12;
v12 = v11 * u5;
vec4 v13;
v13 = v12 + u5;
vec4 v14;
{ vec4 e_ = exp(-abs(v13)); v14 = mix(e_, vec4(1.0), greaterThanEqual(v13, vec4(0.0))) / (1.0 + e_); }
vec4 v15;
v15 = v14 * u6;
vec4 v16;
v16 = v15 + u6;
vec4 v17;
{ vec4 e_ = exp(-abs(v16)); v17 = mix(e_, vec4(1.0), greaterThanEqual(v16, vec4(0.0))) / (1.0 + e_); }
vec4 v18;
v18 = v17 * u7;
vec4 v19;
v19 = v18 + u7;
vec4 v20;
{ vec4 e_ = exp(-abs(v19)); v20 = mix(e_, vec4(1.0), greaterThanEqual(v19, vec4(0.0))) / (1.0 + e_); }
vec4 v21;
v21 = v20 * u8;
vec4 v22;
v22 = v21 + u8;
vec4 v23;
{ vec4 e_ = exp(-abs(v22)); v23 = mix(e_, vec4(1.0), greaterThanEqual(v22, vec4(0.0))) / (1.0 + e_); }
vec4 v24;
v24 = v23 * u9;
vec4 v25;
v25 = v24 + u9;
vec4 v26;
{ vec4 e_ = exp(-abs(v25)); v26 = mix(e_, vec4(1.0), greaterThanEqual(v25, vec4(0.0))) / (1.0 + e_); }
vec4 v27;
v27 = v26 * u10;
vec4 v28;
v28 = v27 + u10;
vec4 v29;
{ vec4 e_ = exp(-abs(v28)); v29 = mix(e_, vec4(1.0), greaterThanEqual(v28, vec4(0.0))) / (1.0 + e_); }
vec4 v30;
v30 = v29 * u11;
vec4 v31;
v31 = v30 + u11;
vec4 v32;
{ vec4 e_ = exp(-abs(v31)); v32 = mix(e_, vec4(1.0), greaterThanEqual(v31, vec4(0.0))) / (1.0 + e_); }
vec4 v33;
v33 = v32 * u12;
vec4 v34;
v34 = v33 + u12;
vec4 v35;
{ vec4 e_ = exp(-abs(v34)); v35 = mix(e_, vec4(1.0), greaterThanEqual(v34, vec4(0.0))) / (1.0 + e_); }
vec4 v36;
v36 = v35 * u13;
vec4 v37;
v37 = v36 + u13;
vec4 v38;
{ vec4 e_ = exp(-abs(v37)); v38 = mix(e_, vec4(1.0), greaterThanEqual(v37, vec4(0.0))) / (1.0 + e_); }
vec4 v39;
v39 = v38 * u14;
vec4 v40;
v40 = v39 + u14;
vec4 v41;
{ vec4 e_ = exp(-abs(v40)); v41 = mix(e_, vec4(1.0), greaterThanEqual(v40, vec4(0.0))) / (1.0 + e_); }
vec4 v42;
v42 = v41 * u15;
o0 = v42;
}

// shader 2 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(input_attachment_index = 0, set = 0, binding = 0) uniform subpassInput t0;
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0))
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0))
#define E2(i) T2(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0))
#define E3(i) T3(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 4) uniform texture2D t4;
#define T4(c) (texelFetch(t4, c, 0))
#define E4(i) T4(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 5) uniform texture2D t5;
#define T5(c) (texelFetch(t5, c, 0))
#define E5(i) T5(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec4 o0;
layout(location = 1) out vec4 o1;
layout(location = 2) out vec4 o2;
layout(location = 3) out vec4 o3;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec4 u0 = subpassLoad(t0);
vec4 u1 = T1(pixel);
vec4 u2 = T2(pixel);
vec4 u3 = T3(pixel);
vec4 u4 = T4(pixel);
vec4 u5 = T5(pixel);
vec4 v0;
v0 = u0 + u1;
vec4 v1;
{ vec4 e_ = exp(-abs(v0)); v1 = mix(e_, vec4(1.0), greaterThanEqual(v0, vec4(0.0))) / (1.0 + e_); }
vec4 v2;
v2 = v1 * u2;
vec4 v3;
v3 = v2 + u2;
vec4 v4;
{ vec4 e_ = exp(-abs(v3)); v4 = mix(e_, vec4(1.0), greaterThanEqual(v3, vec4(0.0))) / (1.0 + e_); }
vec4 v5;
v5 = v4 * u3;
vec4 v6;
v6 = v5 + u3;
vec4 v7;
{ vec4 e_ = exp(-abs(v6)); v7 = mix(e_, vec4(1.0), greaterThanEqual(v6, vec4(0.0))) / (1.0 + e_); }
vec4 v8;
v8 = v7 * u4;
vec4 v9;
v9 = v8 + u4;
vec4 v10;
{ vec4 e_ = exp(-abs(v9)); v10 = mix(e_, vec4(1.0), greaterThanEqual(v9, vec4(0.0))) / (1.0 + e_); }
vec4 v11;
v11 = v10 * u5;
vec4 v12;
v12 = v11 + u5;
vec4 v13;
{ vec4 e_ = exp(-abs(v12)); v13 = mix(e_, vec4(1.0), greaterThanEqual(v12, vec4(0.0))) / (1.0 + e_); }
vec4 v14;
v14 = v13 * 2.0;
vec4 v15;
v15 = v13 * 3.0;
vec4 v16;
v16 = v13 * 4.0;
o0 = v13;
o1 = v14;
o2 = v15;
o3 = v16;
}

// shader 3 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(input_attachment_index = 0, set = 0, binding = 0) uniform subpassInput t0;
layout(location = 0) out vec4 o0;
layout(location = 1) out vec4 o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec4 u0 = subpassLoad(t0);
vec4 v0;
v0 = u0 * 5.0;
vec4 v1;
v1 = u0 * 6.0;
o0 = v0;
o1 = v1;
}
