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
#define T0(c) (texelFetch(t0, c, 0).xy)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec2 u0 = T0(pixel);
int v0;
v0 = 1;
vec4 v1;
{ vec2 s_ = u0 * vec2(9, 7) - 0.5, b_ = floor(s_);
    ivec2 z_ = ivec2(9, 7);
    v1 = vec4((ivec2(clamp(b_, -2e9, 2e9)) % z_ + z_) % z_, s_ - b_); if (v0 == 0) v1.xy = vec2(-1.0, 0.0); }
o0 = v1;
}

// shader 2 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0))
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(location = 0) out ivec2 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 v0;
v0 = ivec2(2147483647, (pixel.y * 4 + pixel.x));
    if ((pixel.y * 4 + pixel.x) < 96) { vec2 f_ = E0((pixel.y * 4 + pixel.x)).xy; if (f_.x >= 0.0) v0.x = int(f_.y) * 9 + int(f_.x); }
o0 = v0;
}

// shader 3 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xy)
#define E0(i) T0(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2(i, 0))
layout(location = 0) out ivec2 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u1 = T1(ivec2(0));
ivec2 v0;
{ int n_ = 4 * 24, d_ = (pixel.y * 4 + pixel.x) & (2 * u1 - 1), first_ = (pixel.y * 4 + pixel.x) - d_, second_ = first_ + u1;
    v0 = T0(pixel);
    if (second_ < n_ && E0(second_ - 1).x > E0(second_).x) {
        int size_ = min(u1, n_ - second_), lo_ = max(d_ - size_, 0), hi_ = min(d_, u1);
        while (lo_ < hi_) {
            int m_ = (lo_ + hi_) >> 1;
            if (E0(first_ + m_).x <= E0(second_ + d_ - 1 - m_).x) lo_ = m_ + 1; else hi_ = m_;
        }
        ivec2 u_ = E0(first_ + min(lo_, u1 - 1)), v_ = E0(second_ + min(d_ - lo_, size_ - 1));
        v0 = lo_ < u1 && (d_ - lo_ >= size_ || u_.x <= v_.x) ? u_ : v_;
    } }
o0 = v0;
}

// shader 4 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xy)
#define E0(i) T0(ivec2((i) & 3, (i) >> 2))
layout(location = 0) out ivec2 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 v0;
{ int n_ = 4 * 24, lo_ = 0, hi_ = n_, step_ = 1;
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if (E0(m_).x < (pixel.y * 9 + pixel.x)) lo_ = m_ + 1; else hi_ = m_; }
    v0 = ivec2(lo_);
    while (hi_ < n_ && E0(hi_).x == (pixel.y * 9 + pixel.x)) { lo_ = hi_ + 1; hi_ = min(lo_ + step_, n_); step_ *= 2; }
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if (E0(m_).x == (pixel.y * 9 + pixel.x)) lo_ = m_ + 1; else hi_ = m_; }
    v0.y = lo_; }
o0 = v0;
}

// shader 5 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xy)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(location = 0) out ivec2 o0;
layout(location = 1) out int o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 v0;
{ int x_ = pixel.x, y_ = pixel.y, r_ = 9 - 1, b_ = 7 - 1, l_ = x_ == 0 ? r_ : x_ - 1, u_ = y_ == 0 ? b_ : y_ - 1;
    ivec2 own_ = T0(pixel), left_ = T0(ivec2(l_, y_)), above_ = T0(ivec2(x_, u_)), corner_ = T0(ivec2(l_, u_)),
          right_ = T0(ivec2(r_, y_)), end_ = T0(ivec2(r_, u_));
    int begin_ = T0(ivec2(0, u_)).x, last_ = T0(ivec2(r_, b_)).y - T0(ivec2(0, b_)).x;
    int s_ = own_.x + (x_ == 0 ? own_.x : right_.y - right_.x + left_.x) + (y_ == 0 ? above_.x - begin_ : last_ + above_.x)
           + (y_ == 0 ? 0 : last_ + begin_) + (x_ == 0 ? 0 : end_.y - end_.x + corner_.x - begin_);
    v0 = ivec2(s_, s_ + own_.y - own_.x + left_.y - left_.x + above_.y - above_.x + corner_.y - corner_.x); }
int v1;
v1 = v0.y;
int v2;
v2 = v0.x;
int v3;
v3 = int(v1 > v2);
o0 = v0;
o1 = v3;
}

// shader 6 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).xy)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).xy)
#define E1(i) T1(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 2) uniform itexture2D t2;
#define T2(c) (texelFetch(t2, c, 0).xy)
#define E2(i) T2(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0))
#define E3(i) T3(ivec2((i) % 12, (i) / 12))
layout(location = 0) out vec2 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec2 v0;
{ int lo_ = 0, hi_ = 9 * 7;
    if ((pixel.y * 4 + pixel.x) >= E0(hi_ - 1).y) hi_ = 0;
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if (E0(m_).x <= (pixel.y * 4 + pixel.x)) lo_ = m_ + 1; else hi_ = m_; }
    ivec2 r_ = lo_ > 0 ? E0(lo_ - 1) : ivec2(0);
    v0 = vec2(0.0);
    if ((pixel.y * 4 + pixel.x) < r_.y) {
        int x_ = (lo_ - 1) % 9, y_ = (lo_ - 1) / 9, j_ = (pixel.y * 4 + pixel.x) - r_.x, corner_ = 0;
        ivec2 b_ = T1(ivec2(x_, y_));
        while (j_ >= b_.y - b_.x && corner_ < 3) {
            j_ -= b_.y - b_.x;
            ++corner_;
            b_ = T1(ivec2((corner_ & 1) == 0 ? x_ : x_ == 0 ? 9 - 1 : x_ - 1,
                              corner_ < 2 ? y_ : y_ == 0 ? 7 - 1 : y_ - 1));
        }
        int k_ = E2(b_.x + j_).y;
        vec2 f_ = E3(k_).zw;
        v0 = vec2(k_, ((corner_ & 1) == 0 ? 1.0 - f_.x : f_.x) * (corner_ < 2 ? 1.0 - f_.y : f_.y));
    } }
o0 = v0;
}

// shader 7 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) % 9, (i) / 9))
layout(location = 0) out int o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
float u0 = T0(pixel);
int u1 = T1(pixel);
int v0;
v0 = int(floatBitsToInt(float(u0)) != floatBitsToInt(float(u0)));
int v1;
v1 = u1 | v0;
o0 = v1;
}

// shader 8 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(location = 0) out int o0;
layout(location = 1) out int o1;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int v0 = int(0);
for (int k_ = 0; k_ < min((pixel.y * 1 + pixel.x) * 64 + 64, 63); ++k_) { v0 += E0(k_) * 1; }
int v1;
v1 = v0 / 1;
o0 = v0;
o1 = v1;
}

// shader 9 (vert)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 4) uniform itexture2D t4;
#define T4(c) (texelFetch(t4, c, 0).x)
#define E4(i) T4(ivec2(i, 0))
void main() {
int corner = gl_VertexIndex % 6, full = T4(ivec2(0, 0)) / (64 * 1), rest = T4(ivec2(0, 0)) - full * 64 * 1;
bool last = gl_VertexIndex >= 6;
vec2 low = vec2(last ? full * 64 : 0, 0);
vec2 high = vec2((last ? full + 1 : full) * 64, last ? (rest + 64 - 1) / 64 : 1);
vec2 o = vec2(corner == 1 || corner == 3 || corner == 5 ? high.x : low.x, corner >= 2 && corner != 3 ? high.y : low.y);
gl_Position = vec4(o / vec2(64, 1) * 2.0 - 1.0, 0.0, 1.0);

}

// shader 10 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2(i, 0))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0).x)
#define E2(i) T2(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 3) uniform itexture2D t3;
#define T3(c) (texelFetch(t3, c, 0).xy)
#define E3(i) T3(ivec2((i) % 9, (i) / 9))
layout(location = 0) out int o0;
layout(location = 1) out float o1;
layout(location = 2) out ivec2 o2;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 v0;
v0 = ivec2(-1, 0);
{ int s_ = (pixel.y * 64 + pixel.x) * 1, end_ = s_ < T0(ivec2(1 - 1, 1 - 1)) ? 1 : 0, before_ = 0, k_ = 0;
  for (; k_ < end_; ++k_) { int c_ = E0(k_); if (s_ < c_) break; before_ = c_; }
  if (end_ > 0) v0 = ivec2(k_, (s_ - before_) / 1); }
ivec2 v1;
{ int k_ = v0.x * 64, end_ = v0.x < 0 ? k_ : min(k_ + 64, 63), rest_ = v0.y;
  for (; k_ < end_; ++k_) { int c_ = E1(k_); if (rest_ < c_) break; rest_ -= c_; }
  v1 = v0.x < 0 ? ivec2(-1, 0) : ivec2(k_, rest_); }
int v2;
v2 = v1.x;
float v3;
v3 = float(0); if (v2 >= 0) v3 = E2(min(v2, 9 * 7 - 1));
ivec2 v4;
v4 = ivec2(0); if (v2 >= 0) v4 = E3(min(v2, 9 * 7 - 1));
o0 = v2;
o1 = v3;
o2 = v4;
}

// shader 11 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2(i, 0))
layout(set = 0, binding = 2) uniform itexture2D t2;
#define T2(c) (texelFetch(t2, c, 0).x)
#define E2(i) T2(ivec2(i, 0))
layout(location = 0) out int o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u0 = T0(pixel);
int v0;
{ int low_ = 0, high_ = u0 != 0 ? T2(ivec2(1 - 1, 1 - 1)) / 1 : 0;
  while (low_ < high_) { int mid_ = (low_ + high_) >> 1; if (E1(mid_) < (pixel.y * 9 + pixel.x)) low_ = mid_ + 1; else high_ = mid_; }
  v0 = u0 != 0 ? low_ : -1; }
int v1;
v1 = v0 + 1;
o0 = v1;
}

// shader 12 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0).xy)
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(location = 0) out ivec4 o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
vec2 u1 = T1(pixel);
int v0;
v0 = 1;
ivec4 v1;
{ vec2 s_ = u1 * vec2(9, 7) - 0.5, b_ = floor(s_);
    s_ -= b_; ivec2 k_ = ivec2(clamp(b_, -2e9, 2e9)), z_ = ivec2(9, 7);ivec2 lo_ = (k_ % z_ + z_) % z_, hi_ = ivec2(lo_.x + 1 == z_.x ? 0 : lo_.x + 1, lo_.y + 1 == z_.y ? 0 : lo_.y + 1);int t00_ = T0(lo_), t10_ = T0(ivec2(hi_.x, lo_.y)),
    t01_ = T0(ivec2(lo_.x, hi_.y)), t11_ = T0(hi_);v1 = (v0 != 0 ? ivec4(t00_, t10_, t01_, t11_) : ivec4(0)) - 1; }
o0 = v1;
}

// shader 13 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform itexture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(set = 0, binding = 1) uniform texture2D t1;
#define T1(c) (texelFetch(t1, c, 0).x)
#define E1(i) T1(ivec2(i, 0))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
int u0 = T0(pixel);
if (u0 == 0) discard;
int v0;
v0 = u0 - 1;
float v1;
v1 = float(0); if (v0 >= 0) v1 = E1(min(v0, 64 * 1 - 1));
float v2;
v2 = u0 != 0 ? float(v1) : float(0.0);
o0 = v2;
}

// shader 14 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2(i, 0))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0))
#define E1(i) T1(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0).xy)
#define E2(i) T2(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0).x)
#define E3(i) T3(ivec2((i) % 12, (i) / 12))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec4 u1 = T1(pixel);
vec2 u2 = T2(pixel);
float u3 = T3(pixel);
float v0;
v0 = 0.010416666977107525;
float v1;
{ vec2 s_ = u2 * vec2(9, 7) - 0.5; s_ -= floor(s_); ivec4 k_ = max(u1, ivec4(0));
    float t00_ = E0(k_.x), t10_ = E0(k_.y), t01_ = E0(k_.z), t11_ = E0(k_.w);
    v1 = u1.x >= 0 ? mix(mix(t00_, t10_, s_.x), mix(t01_, t11_, s_.x), s_.y) : float(0); }
float v2;
v2 = v1 - u3;
float v3;
v3 = v0 * v2;
float v4;
v4 = v3 + v3;
o0 = v4;
}

// shader 15 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 12, (i) / 12))
layout(set = 0, binding = 1) uniform itexture2D t1;
#define T1(c) (texelFetch(t1, c, 0).xy)
#define E1(i) T1(ivec2(i, 0))
layout(set = 0, binding = 2) uniform texture2D t2;
#define T2(c) (texelFetch(t2, c, 0).xy)
#define E2(i) T2(ivec2((i) & 3, (i) >> 2))
layout(set = 0, binding = 3) uniform texture2D t3;
#define T3(c) (texelFetch(t3, c, 0).x)
#define E3(i) T3(ivec2(i, 0))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
ivec2 u1 = T1(pixel);
float u3 = T3(pixel);
float v0 = float(0);
for (int k_ = u1.x; k_ < u1.y; ++k_) { vec2 e_ = E2(k_); v0 += e_.y * E0(int(e_.x)); }
float v1;
v1 = v0 * 0.10000000149011612;
float v2;
v2 = u3 - v1;
o0 = v2;
}

// shader 16 (frag)
#version 450
#extension GL_EXT_samplerless_texture_functions : require
layout(set = 0, binding = 0) uniform texture2D t0;
#define T0(c) (texelFetch(t0, c, 0).x)
#define E0(i) T0(ivec2((i) % 9, (i) / 9))
layout(location = 0) out float o0;
void main() {
ivec2 pixel = ivec2(gl_FragCoord.xy);
float u0 = T0(pixel);
float v0;
v0 = u0 + 0.5;
o0 = v0;
}
