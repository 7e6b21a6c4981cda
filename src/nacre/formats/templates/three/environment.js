/**
 * Light from all around for materials of nacre: an equirectangular picture with its own chain of smaller pictures, and
 * its irradiance in nine spherical harmonics (Ramamoorthi and Hanrahan 2001).
 */
import { ClampToEdgeWrapping, DataTexture, DataUtils, HalfFloatType, LinearFilter, LinearMipmapLinearFilter, RGBAFormat,
  RepeatWrapping, Vector3 } from 'three';

const HIGHEST = 65504;
const COSINE = [Math.PI, 2 * Math.PI / 3, 2 * Math.PI / 3, 2 * Math.PI / 3, Math.PI / 4, Math.PI / 4, Math.PI / 4,
  Math.PI / 4, Math.PI / 4];

function basis(x, y, z) {
  return [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
    0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)];
}

function half(rgb) {
  const out = new Uint16Array(rgb.length / 3 * 4);
  for (let i = 0; i < rgb.length / 3; i += 1) {
    for (let c = 0; c < 3; c += 1) out[4 * i + c] = DataUtils.toHalfFloat(Math.min(Math.max(rgb[3 * i + c], 0), HIGHEST));
    out[4 * i + 3] = 0x3c00;
  }
  return out;
}

function resized(rgb, width, height, columns, rows) {
  const out = new Float32Array(3 * columns * rows), a = width / columns, b = height / rows;
  for (let r = 0; r < rows; r += 1) {
    for (let q = 0; q < columns; q += 1) {
      const x0 = Math.floor(q * a), x1 = Math.max(x0 + 1, Math.floor((q + 1) * a));
      const y0 = Math.floor(r * b), y1 = Math.max(y0 + 1, Math.floor((r + 1) * b));
      for (let c = 0; c < 3; c += 1) {
        let sum = 0;
        for (let y = y0; y < y1; y += 1) for (let x = x0; x < x1; x += 1) sum += rgb[3 * (y * width + x) + c];
        out[3 * (r * columns + q) + c] = sum / ((x1 - x0) * (y1 - y0));
      }
    }
  }
  return out;
}

export class NacreEnvironment {
  /**
   * @param {object} picture an equirectangular texture of three (float, half float or 8 bits), or
   *   `{ data: Float32Array, width, height }` of linear RGB, first row at the bottom.
   * @param {{ columns?: number, rotation?: number, intensity?: number }} [options] width of the stored picture, turn
   *   about the vertical in radians, and a factor.
   */
  constructor(picture, { columns = 512, rotation = 0, intensity = 1 } = {}) {
    const { data, width, height } = picture.isTexture ? read(picture) : picture;
    if (!(data.length === 3 * width * height)) throw new Error('NacreEnvironment: data holds not 3 * width * height values');
    this.rotation = rotation;
    this.intensity = intensity;
    let w = Math.min(columns, 2 ** Math.floor(Math.log2(width))), h = Math.max(1, w / 2);
    let level = resized(data, width, height, w, h);
    this.irradiance = project(level, w, h);
    const mipmaps = [];
    for (;;) {
      mipmaps.push({ data: half(level), width: w, height: h });
      if (w === 1 && h === 1) break;
      const smaller = [Math.max(1, w / 2), Math.max(1, h / 2)];
      level = resized(level, w, h, ...smaller);
      [w, h] = smaller;
    }
    const [first] = mipmaps;
    this.texture = new DataTexture(first.data, first.width, first.height, RGBAFormat, HalfFloatType);
    this.texture.mipmaps = mipmaps;
    this.texture.generateMipmaps = false;
    this.texture.wrapS = RepeatWrapping;
    this.texture.wrapT = ClampToEdgeWrapping;
    this.texture.magFilter = LinearFilter;
    this.texture.minFilter = LinearMipmapLinearFilter;
    this.texture.needsUpdate = true;
  }
  dispose() { this.texture.dispose(); }
}

function read(texture) {
  const { data, width, height } = texture.image, channels = data.length / (width * height);
  const number = data instanceof Uint16Array ? DataUtils.fromHalfFloat
    : data instanceof Float32Array ? (v) => v : (v) => { const s = v / 255; return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4; };
  const out = new Float32Array(3 * width * height);
  for (let r = 0; r < height; r += 1) {
    const row = texture.flipY ? height - 1 - r : r;
    for (let q = 0; q < width; q += 1) {
      for (let c = 0; c < 3; c += 1) out[3 * (r * width + q) + c] = number(data[channels * (row * width + q) + c]);
    }
  }
  return { data: out, width, height };
}

function project(rgb, width, height) {
  const out = Array.from({ length: 9 }, () => new Vector3());
  for (let r = 0; r < height; r += 1) {
    const latitude = ((r + 0.5) / height - 0.5) * Math.PI;
    const area = (2 * Math.PI / width) * (Math.sin((r + 1) / height * Math.PI - Math.PI / 2) - Math.sin(r / height * Math.PI - Math.PI / 2));
    for (let q = 0; q < width; q += 1) {
      const longitude = ((q + 0.5) / width - 0.5) * 2 * Math.PI, flat = Math.cos(latitude);
      const y = basis(flat * Math.cos(longitude), Math.sin(latitude), flat * Math.sin(longitude));
      const at = 3 * (r * width + q);
      for (let k = 0; k < 9; k += 1) {
        const weight = y[k] * area * COSINE[k];
        out[k].x += weight * rgb[at]; out[k].y += weight * rgb[at + 1]; out[k].z += weight * rgb[at + 2];
      }
    }
  }
  return out;
}
