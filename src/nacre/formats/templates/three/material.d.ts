import { DataTexture, ShaderMaterial, Texture, Vector3 } from 'three';

/** Description of the stored colours. */
export interface NacreTable {
  name: string;
  illuminant: string;
  parameter: { name: string; low: number; high: number } | null;
  is_two_sided: boolean;
  /** The other material of a blend, and the share of the first one: a number, or a picture over uv. */
  second: NacreTable | null;
  share: number | null;
  errors_dE00: Record<string, Record<string, number>>;
  lost: string[];
}
export const TABLE: NacreTable;

/** Light from all around. */
export class NacreEnvironment {
  constructor(
    picture: Texture | { data: Float32Array; width: number; height: number },
    options?: { columns?: number; rotation?: number; intensity?: number },
  );
  /** Turn about the vertical in radians. */
  rotation: number;
  intensity: number;
  readonly texture: DataTexture;
  readonly irradiance: Vector3[];
  dispose(): void;
}

export interface NacreOptions {
  environment?: NacreEnvironment | null;
  /** Value of the number that varies over the surface; null: the recipe's map over uv. */
  value?: number | null;
  /** Whether the geometry has tangents, along which a brushed surface runs; by default u. */
  tangents?: boolean;
  /** Whether colours outside sRGB keep their negative channels; for pipelines in floats. */
  unclipped?: boolean;
}

/** For WebGLRenderer. */
export class NacreMaterial extends ShaderMaterial {
  constructor(options?: NacreOptions);
  get environment(): NacreEnvironment | null;
  set environment(environment: NacreEnvironment | null);
  set value(value: number | null);
}
