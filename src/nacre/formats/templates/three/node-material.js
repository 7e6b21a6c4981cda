/** A `NodeMaterial` in TSL for three's WebGPURenderer, with WebGPU and with WebGL 2. */
import { CustomBlending, DoubleSide, FrontSide, LightingModel, NodeMaterial, OneFactor, OneMinusSrcAlphaFactor,
  Vector3 } from 'three/webgpu';
import { Fn, If, Loop, acos, abs, asin, atan, bool, cameraWorldMatrix, clamp, cos, cross, dFdx, dFdy, dot, exp, float, floor, fract,
  inverseSqrt, length, log2, max, min, mix, normalViewGeometry, normalize, positionView, positionViewDirection, pow, reflect, select,
  sin, sqrt, tangentView, texture, uniform, uniformArray, uv, vec2, vec3, vec4 } from 'three/tsl';
import { NacreEnvironment } from './environment.js';
import { PARTS, TABLE, positions, textures } from './table.js';

export { NacreEnvironment, TABLE };

const SAMPLES = @SAMPLES@;
const roughOf = ({ facets }) => !!facets && facets.alpha[0] > 0;
const isBrushed = PARTS.some((part) => roughOf(part) && part.facets.alpha[0] !== part.facets.alpha[1]);
const isClear = PARTS.some((part) => part.pictures.through);
const isTwoSided = PARTS.every((part) => part.is_two_sided);

const angle = (c) => acos(clamp(c, 0, 1)).mul(2 / Math.PI);

/** The TSL functions of a table; `held` are its textures. All directions are in the frame of the surface, z the normal. */
export function lookUps(table, held) {
  const { facets, pictures } = table, isRough = roughOf(table), isBent = !!facets && facets.transmits && !facets.straight;
  const texel = (name, x, y, band = float(0)) => {
    const { columns, rows, bands } = pictures[name];
    const across = clamp(x, 0, 1).mul(columns - 1).add(0.5).div(columns);
    const up = clamp(y, 0, 1).mul(rows - 1).add(0.5).add(float(band).mul(rows)).div(rows * bands);
    return texture(held[name], vec2(across, up)).level(0).rgb;
  };
  const view = (name, cosine, row, side) => texel(name, angle(cosine), row, min(side, pictures[name].bands - 1));

  // ---- the interface of a film, as in the GLSL
  const inside01 = (z) => (facets.is_flipped ? select(z.lessThan(0), float(0), float(1)) : select(z.lessThan(0), float(1), float(0)));
  const interfaceAt = (cosine, inside, p) => {
    const c = clamp(cosine, 0, 1);
    if (!facets.transmits) {
      return { reflected: texel('facet', angle(c), p).mul(inside.oneMinus()), passed: vec3(0) };
    }
    const eta = facets.eta, critical = Math.sqrt(Math.max(0, 1 - 1 / (eta * eta)));
    const within = sqrt(max(0, float(1).sub(c.mul(c).oneMinus().mul(eta * eta))));
    const outer = select(inside.greaterThan(0.5), within, c);
    const total = critical > 0 ? inside.greaterThan(0.5).and(c.lessThan(critical)) : bool(false);
    const beyond = critical > 0 ? texel('facet', angle(c.div(Math.max(critical, 1e-6))), p, 3) : vec3(0);
    return {
      reflected: select(total, beyond, texel('facet', angle(outer), p, inside.mul(2))),
      passed: select(total, vec3(0), texel('facet', angle(outer), p, 1)),
    };
  };
  /** What a smooth surface reflects and passes straight on, seen along w. */
  const mirror = (w, p) => {
    const found = interfaceAt(abs(w.z), inside01(w.z), p);
    return { reflected: isRough ? vec3(0) : found.reflected, passed: isBent ? vec3(0) : found.passed };
  };

  const alpha = isRough ? vec2(...facets.alpha) : null;
  const kind = isRough ? ['ggx', 'beckmann', 'blinn', 'ashikhmin-shirley'].indexOf(facets.distribution) : 0;
  const density = (m) => {
    const z = max(m.z, 1e-6), slope = m.xy.div(alpha), s = dot(slope, slope);
    const area = Math.PI * facets.alpha[0] * facets.alpha[1];
    if (kind === 0) return float(1 / area).div(s.add(z.mul(z)).mul(s.add(z.mul(z))));
    if (kind === 1) return exp(s.negate().div(z.mul(z))).div(z.mul(z).mul(z).mul(z).mul(area));
    const [ex, ey] = facets.alpha.map((a) => 2 / (a * a) - 2), add = kind === 2 ? 2 : 1;
    const power = m.x.mul(m.x).mul(ex).add(m.y.mul(m.y).mul(ey)).div(max(dot(m.xy, m.xy), 1e-12));
    return pow(z, power).mul(Math.sqrt((ex + add) * (ey + add)) / (2 * Math.PI));
  };
  const smith = (w) => {
    const wide = w.xy.mul(alpha), tan2 = dot(wide, wide).div(max(w.z.mul(w.z), 1e-12));
    if (kind === 0) return float(2).div(sqrt(tan2.add(1)).add(1));
    const a = inverseSqrt(max(tan2, 1e-12)), aa = a.mul(a);
    const found = min(a.mul(3.535).add(aa.mul(2.181)).div(a.mul(2.276).add(aa.mul(2.577)).add(1)), 1);
    return select(a.greaterThanEqual(1.6), float(1), found);
  };
  const lost = (w, side) => {
    const flat = dot(w.xy, w.xy);
    const t = select(flat.greaterThan(1e-12), w.x.mul(w.x).div(max(flat, 1e-12)), float(0.5));
    return texel('loss', sqrt(abs(w.z)), t, side).r;
  };
  const below = (z) => select(z.lessThan(0), float(1), float(0));
  const facetsBetween = (wi, wo, p) => {
    const sides = pictures.loss.bands, i = below(wi.z), o = below(wo.z);
    const found = texel('exchange', float(0), p, i.mul(sides).add(o)).mul(lost(wi, i)).mul(lost(wo, o));
    return select(max(i, o).greaterThan(sides - 0.5), vec3(0), found);
  };
  const spread = Fn(([wiIn, woIn, p]) => {
    const turn = vec3(1, 1, facets.is_flipped ? -1 : 1), wi = wiIn.mul(turn).toVar(), wo = woIn.mul(turn).toVar();
    const insideI = below(wi.z), insideO = below(wo.z), same = insideI.equal(insideO);
    const index = (inside) => (isBent ? select(same, float(1), mix(float(1), float(facets.eta), inside)) : float(1));
    const ni = index(insideI), no = index(insideO), sum = wi.mul(ni).add(wo.mul(no)).toVar();
    const value = vec3(0).toVar();
    const isSeen = abs(wi.z).greaterThan(1e-5).and(abs(wo.z).greaterThan(1e-5)).and(dot(sum, sum).greaterThan(1e-12));
    If(isBent ? isSeen : isSeen.and(same), () => {
      const m = normalize(sum).toVar();
      m.assign(select(m.z.lessThan(0), m.negate(), m));
      const im = dot(wi, m).toVar(), om = dot(wo, m).toVar();
      const least = min(abs(wi.z.div(im)), abs(wo.z.div(om)));
      const masking = kind <= 1 ? smith(wi).mul(smith(wo)) : kind === 2 ? min(1, m.z.mul(2).mul(least)) : least;
      const isLit = im.mul(wi.z).greaterThan(0).and(om.mul(wo.z).greaterThan(0));
      const shape = select(isLit, density(m).mul(masking), float(0)).div(abs(wi.z.mul(wo.z)));
      const { reflected, passed } = interfaceAt(abs(im), insideI, p);
      const bend = ni.mul(im).add(no.mul(om));
      const through = passed.mul(shape).mul(abs(im.mul(om))).mul(no.mul(no)).div(max(bend.mul(bend), 1e-12));
      value.assign(isBent ? select(same, reflected.mul(shape).mul(0.25), through) : reflected.mul(shape).mul(0.25));
      if (pictures.loss) value.addAssign(facetsBetween(wi, wo, p));
    });
    return value;
  });

  // ---- scattered light over half and difference angle
  const scattered = Fn(([wi, wo]) => {
    const value = vec3(0).toVar();
    If(wi.z.greaterThan(0).and(wo.z.greaterThan(0)), () => {
      const slices = pictures.lobe.bands, h = normalize(wi.add(wo)).toVar();
      const cosH = clamp(h.z, 0, 1), sinH = length(h.xy), sinD = length(wi.sub(wo)).mul(0.5);
      const cosD = sqrt(max(0, sinD.mul(sinD).oneMinus())), product = sinH.mul(sinD);
      const along = select(product.lessThan(1e-6), float(0), clamp(abs(wi.z.sub(cosD.mul(cosH))).div(max(product, 1e-9)), 0, 1)).toVar();
      const x = sqrt(atan(sinH, cosH).mul(2 / Math.PI)).toVar();
      const y = atan(sinD, cosD).div(max(atan(cosH, sinH.mul(along)), 1e-6)).toVar();
      const at = acos(along).mul(2 / Math.PI * (slices - 1)), low = min(floor(at), slices - 2).toVar();
      const ci = max(wi.z, 1e-4), co = max(wo.z, 1e-4);
      const found = mix(texel('lobe', x, y, low), texel('lobe', x, y, low.add(1)), at.sub(low));
      value.assign(found.mul(ci.add(co)).div(ci.mul(co).mul(2 * Math.PI)));
    });
    return value;
  });

  /** All but mirror directions, 1/sr, without the cosine. */
  const brdf = (wi, wo, p) => {
    let value = vec3(0);
    if (isRough) value = value.add(spread(wi, wo, p));
    if (pictures.lobe) value = value.add(scattered(wi, wo));
    return value;
  };
  return { brdf, mirror, view, spread, alpha };
}

class NacreLighting extends LightingModel {
  constructor(material) { super(); this.material = material; }
  direct({ lightDirection, lightColor, reflectedLight }) {
    const sent = this.material.both(({ tables, surface: { frame: [t, b, n], wo, p } }) => {
      const wi = vec3(dot(lightDirection, t), dot(lightDirection, b), dot(lightDirection, n)).toVar();
      return tables.brdf(wi, wo, p).mul(abs(wi.z));
    });
    reflectedLight.directSpecular.addAssign(sent.mul(lightColor));
  }
  indirect(builder) {
    const { irradiance, reflectedLight } = builder.context;
    const albedo = this.material.both(({ table, tables, surface: { wo, row, side } }) => (
      table.pictures.albedo ? tables.view('albedo', abs(wo.z), row, side) : vec3(0)));
    reflectedLight.indirectDiffuse.addAssign(irradiance.div(Math.PI).mul(albedo));
  }
}

export class NacreNodeMaterial extends NodeMaterial {
  /**
   * @param {{ environment?: NacreEnvironment | null, value?: number | null, tangents?: boolean, unclipped?: boolean }} [options] as of
   *   `NacreMaterial` in material.js.
   */
  constructor({ environment = null, value = null, tangents = false, unclipped = false } = {}) {
    super();
    this.type = 'NacreNodeMaterial';
    this.name = TABLE.name;
    this.lights = true;
    this.fog = true;
    this.tangents = tangents;
    this.unclipped = unclipped;
    this.parts = PARTS.map((table) => {
      const held = textures(table);
      return { table, held, tables: lookUps(table, held), position: uniform(0) };
    });
    this.turnUniform = uniform(new Vector3(1, 0, 1)).onObjectUpdate((_, self) => {
      const light = this._environment;
      if (light) self.value.set(Math.cos(light.rotation), Math.sin(light.rotation), light.intensity);
    });
    if (isClear) {
      this.transparent = true;
      this.blending = CustomBlending;
      this.blendSrc = OneFactor;
      this.blendDst = OneMinusSrcAlphaFactor;
      this.side = isTwoSided ? DoubleSide : FrontSide;
    }
    this.environment = environment;
    this.value = value;
  }
  get environment() { return this._environment ?? null; }
  set environment(environment) { this._environment = environment; this.needsUpdate = true; }
  set value(value) { positions(value).forEach((at, i) => { this.parts[i].position.value = at; }); }
  customProgramCacheKey() { return `${super.customProgramCacheKey()}-${this.id}-${this._environment?.texture.id ?? 0}`; }

  setupLightingModel() { return new NacreLighting(this); }
  setupLighting(builder) {
    for (const part of this.parts) part.surface = this.surfaceHere(part);
    const { share } = this.parts[0].held;
    this.share = share ? texture(share, uv()).level(0).r.toVar() : float(TABLE.share ?? 1);
    const lit = super.setupLighting(builder);
    if (isClear) {
      const clear = this.both(({ table, tables, surface: { wo, row, side } }) => (table.pictures.through
        ? dot(tables.view('through', abs(wo.z), row, side), vec3(0.2126, 0.7152, 0.0722)) : float(0)));
      this.alphaHere = clamp(clear.oneMinus(), 0, 1);
    }
    const sent = this._environment ? lit.add(this.both((part) => this.surroundings(part))) : lit;
    this.sentHere = sent.toVar();
    return this.sentHere;
  }
  setupOutput(builder, output) {
    const rgb = this.unclipped ? this.sentHere : max(this.sentHere, vec3(0)); // three's own output is clipped
    return super.setupOutput(builder, vec4(rgb, isClear ? this.alphaHere : output.a));
  }
  /** A value of the one part, or of both by the share of the first one. */
  both(value) {
    const [first, second] = this.parts;
    return second ? mix(value(second), value(first), this.share) : value(first);
  }

  /** Frame, direction of view in it, and what varies, at this point. */
  surfaceHere({ table, held, position }) {
    const n = normalize(normalViewGeometry).toVar(); // the outward one; normalView turns to the eye
    let t = select(abs(n.z).lessThan(0.9), cross(vec3(0, 0, 1), n), cross(vec3(1, 0, 0), n));
    if (this.tangents) t = tangentView;
    else if (isBrushed) {
      const px = dFdx(positionView), py = dFdy(positionView), sx = dFdx(uv()), sy = dFdy(uv());
      const along = cross(py, n).mul(sx.x).add(cross(n, px).mul(sy.x));
      t = select(dot(along, along).greaterThan(0), along, t);
    }
    t = normalize(t.sub(n.mul(dot(t, n)))).toVar();
    const b = cross(n, t).toVar(), v = positionViewDirection, z = dot(v, n);
    const wo = vec3(dot(v, t), dot(v, b), table.is_two_sided ? z : max(z, 1e-4)).toVar();
    let p = position;
    if (held.map) p = select(p.lessThan(0), texture(held.map, uv()).level(0).r, p);
    p = float(p).toVar();
    const flat = dot(wo.xy, wo.xy);
    const row = table.rows_azimuth ? select(flat.greaterThan(1e-12), wo.x.mul(wo.x).div(max(flat, 1e-12)), float(0.5)).toVar() : p;
    return { frame: [t, b, n], wo, p, row, side: select(wo.z.lessThan(0), float(1), float(0)) };
  }


  /** What reaches the eye from all around: sampled facets (Heitz 2018), spherical harmonics for the diffuse part. */
  surroundings({ table, tables, surface: { frame: [t, b, n], wo, p, row, side } }) {
    const { facets, pictures } = table, isRough = roughOf(table), light = this._environment, turned = this.turnUniform;
    const rotate = (w) => vec3(turned.x.mul(w.x).add(turned.y.mul(w.z)), w.y, turned.x.mul(w.z).sub(turned.y.mul(w.x)));
    const toWorld = (w) => rotate(normalize(cameraWorldMatrix.mul(vec4(t.mul(w.x).add(b.mul(w.y)).add(n.mul(w.z)), 0)).xyz));
    const { width, height } = light.texture.image;
    const incoming = (w, density) => {
      const d = toWorld(w).toVar(), level = log2(max(float(width * height / (4 * Math.PI * SAMPLES)).div(max(density, 1e-6)), 1)).mul(0.5);
      const at = vec2(atan(d.z, d.x).div(2 * Math.PI).add(0.5), asin(clamp(d.y, -1, 1)).div(Math.PI).add(0.5));
      return texture(light.texture, at).level(level).rgb.mul(turned.z);
    };
    const point = (i) => vec2(float(i).add(0.5).div(SAMPLES), fract(float(i).mul(0.6180339887498949)));
    const up = vec3(wo.xy, max(abs(wo.z), 1e-3)).toVar(), flip = select(wo.z.lessThan(0), float(-1), float(1)).toVar();
    const turn = (w) => vec3(w.xy, w.z.mul(flip));
    const visible = (a, u) => {
      const v = normalize(vec3(up.xy.mul(a), up.z)).toVar(), flat = dot(v.xy, v.xy);
      const e = select(flat.greaterThan(1e-9), vec3(v.y.negate(), v.x, 0).mul(inverseSqrt(max(flat, 1e-9))), vec3(1, 0, 0)).toVar();
      const r = sqrt(u.x), phi = u.y.mul(2 * Math.PI).sub(atan(v.y, v.x.add(1e-9))), x = r.mul(cos(phi)).toVar(), s = v.z.add(1).mul(0.5);
      const rest = sqrt(max(0, x.mul(x).oneMinus()));
      const y = s.oneMinus().mul(rest).add(s.mul(r.mul(sin(phi)))).toVar();
      const m = e.mul(x).add(cross(v, e).mul(y)).add(v.mul(sqrt(max(0, x.mul(x).add(y.mul(y)).oneMinus()))));
      return normalize(vec3(m.xy.mul(a), max(m.z, 1e-6)));
    };
    const visibleDensity = (m, a) => {
      const slope = m.xy.div(a), wide = up.xy.mul(a), s = dot(slope, slope).add(m.z.mul(m.z));
      const seen = float(2).div(sqrt(dot(wide, wide).div(max(up.z.mul(up.z), 1e-12)).add(1)).add(1));
      return seen.div(s.mul(s).mul(a.x).mul(a.y).mul(4 * Math.PI).mul(max(up.z, 1e-6)));
    };
    return Fn(() => {
      const sum = vec3(0).toVar();
      if (facets && !isRough) {
        sum.addAssign(tables.mirror(wo, p).reflected.mul(incoming(vec3(wo.xy.negate(), wo.z), float(1e6))));
      }
      const sampled = (a, add) => Loop(SAMPLES, ({ i }) => {
        const m = visible(a, point(i)).toVar(), wi = reflect(up.negate(), m).toVar();
        If(wi.z.greaterThan(0), () => add(wi, visibleDensity(m, a).toVar()));
      });
      if (isRough) {
        sampled(tables.alpha, (wi, density) => {
          const f = tables.spread(turn(wi), turn(up), p);
          sum.addAssign(f.mul(wi.z).div(density).mul(incoming(turn(wi), density)).div(SAMPLES));
        });
      }
      for (const [k, alpha] of table.gloss_alphas.entries()) {
        const total = vec3(0).toVar(), weight = float(0).toVar();
        sampled(vec2(alpha, alpha), (wi, density) => { total.addAssign(incoming(turn(wi), density)); weight.addAssign(1); });
        sum.addAssign(total.div(max(weight, 1)).mul(tables.view('gloss', abs(wo.z), row, float(k))).mul(max(flip, 0)));
      }
      if (pictures.spread) {
        const d = toWorld(vec3(0, 0, flip)).toVar(), c = uniformArray(light.irradiance, 'vec3');
        const found = c.element(0).mul(0.282095)
          .add(c.element(1).mul(d.y).add(c.element(2).mul(d.z)).add(c.element(3).mul(d.x)).mul(0.488603))
          .add(c.element(4).mul(d.x.mul(d.y)).add(c.element(5).mul(d.y.mul(d.z))).add(c.element(7).mul(d.x.mul(d.z))).mul(1.092548))
          .add(c.element(6).mul(d.z.mul(d.z).mul(3).sub(1).mul(0.315392)))
          .add(c.element(8).mul(d.x.mul(d.x).sub(d.y.mul(d.y)).mul(0.546274)));
        sum.addAssign(max(found, vec3(0)).div(Math.PI).mul(tables.view('spread', abs(wo.z), row, side)));
      }
      return sum;
    })();
  }
  dispose() {
    for (const { held } of this.parts) for (const picture of Object.values(held)) picture.dispose();
    super.dispose();
  }
}
