// The tone curves of `tone-map` as shader code; tested to agree with it within one code value.

const OPERATORS = ["linear", "reinhard", "reinhard-extended", "hable", "aces-narkowicz", "aces-hill", "agx", "neutral"];

const TONE_GLSL = `
float hable(float v) { return (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 1.0 / 15.0; }
vec3 hable3(vec3 v) { return vec3(hable(v.x), hable(v.y), hable(v.z)); }
vec3 acesHill(vec3 v) {
  // Matrices stand by columns.
  v = mat3(0.59719, 0.076, 0.0284, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777) * v;
  v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081);
  return mat3(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602) * v;
}
vec3 agx(vec3 v) {
  v = mat3(0.842479062253094, 0.0423282422610123, 0.0423756549057051,
           0.0784335999999992, 0.878468636469772, 0.0784336,
           0.0792237451477643, 0.0791661274605433, 0.879142973793104) * v;
  vec3 x = (clamp(log2(max(v, vec3(1e-30))), -12.47393, 4.026069) + 12.47393) / 16.499999;
  vec3 x2 = x * x, x4 = x2 * x2;
  v = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
  return mat3(1.19687900512017, -0.0528968517574562, -0.0529716355144438,
              -0.0980208811401368, 1.15190312990417, -0.0980434501171241,
              -0.0990297440797205, -0.0989611768448433, 1.15107367264116) * v;
}
vec3 neutral(vec3 v) {
  float darkest = min(v.x, min(v.y, v.z));
  v -= darkest < 0.08 ? darkest - 6.25 * darkest * darkest : 0.04;
  float peak = max(v.x, max(v.y, v.z));
  if (peak < 0.76) return v;
  float d = 1.0 - 0.76;
  float newPeak = 1.0 - d * d / (peak + d - 0.76);
  float whiteness = 1.0 - 1.0 / (0.15 * (peak - newPeak) + 1.0);
  return mix(v * (newPeak / peak), vec3(newPeak), whiteness);
}
vec3 toned(vec3 v, int operator, float white) {
  switch (operator) {
    case 1: return v / (1.0 + v);
    case 2: return v * (1.0 + v / (white * white)) / (1.0 + v);
    case 3: return hable3(2.0 * v) / hable(11.2);
    case 4: return v * (2.51 * v + 0.03) / (v * (2.43 * v + 0.59) + 0.14);
    case 5: return acesHill(v);
    case 6: return agx(v);
    case 7: return neutral(v);
    default: return v;
  }
}
vec3 encoded(vec3 v, float gamma) {
  if (gamma > 0.0) return pow(v, vec3(1.0 / gamma));
  return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, 12.92 * v, lessThanEqual(v, vec3(0.0031308)));
}
`;
