// A shipped policy: what it observes, and the small network that gives its actions.
"use strict";
{
  // The observation of MMCReach-v0 (mmc_gym.interface): speeds are fractions of their limit; target
  // and offset are seen from the first segment, and the offset again, enlarged near 0.
  const observe = ({ angles, speeds, hand, target, near }) => {
    const cosine = Math.cos(angles[0]), sine = Math.sin(angles[0]);
    const seen = ([x, y]) => [cosine * x + sine * y, cosine * y - sine * x];
    const offset = seen([target[0] - hand[0], target[1] - hand[1]]);
    const enlarged = offset.map((part) => part / (near + Math.hypot(...offset)));
    return [...angles.map(Math.cos), ...angles.map(Math.sin), ...speeds, ...seen(target),
      ...offset, ...enlarged].map(Math.fround);
  };

  const floats = (base64) =>
    new Float32Array(Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer);

  class Policy {
    constructor({ layers, activation }) {
      this.layers = layers.map(({ weight, bias }) => ({ weight: floats(weight), bias: floats(bias) }));
      this.activate = { relu: (x) => Math.max(0, x), tanh: Math.tanh }[activation];
      this.joints = this.layers.at(-1).bias.length;
    }

    act(observation) {
      const outputs = this.layers.reduce((inputs, { weight, bias }, layer) =>
        Array.from(bias, (total, unit) => {
          const row = unit * inputs.length;
          for (let i = 0; i < inputs.length; i++) total += weight[row + i] * inputs[i];
          return layer + 1 < this.layers.length ? this.activate(total) : total;
        }), observation);
      return outputs.map((action) => Math.min(1, Math.max(-1, action)));
    }
  }

  Object.assign(playground, { Policy, observe });
}
