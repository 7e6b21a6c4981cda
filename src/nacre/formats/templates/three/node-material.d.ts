import { NodeMaterial } from 'three/webgpu';
import { NacreEnvironment, NacreOptions, TABLE } from './material.js';

export { NacreEnvironment, TABLE };

/** For WebGPURenderer, with WebGPU and with WebGL 2. */
export class NacreNodeMaterial extends NodeMaterial {
  constructor(options?: NacreOptions);
  get environment(): NacreEnvironment | null;
  set environment(environment: NacreEnvironment | null);
  set value(value: number | null);
}
