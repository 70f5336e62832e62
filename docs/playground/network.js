// The MMC network: the iteration of mmc_gym.network, for one arm.  Vectors are pairs [x, y].
"use strict";
{
  const add = ([a, b], [c, d], scale = 1) => [a + scale * c, b + scale * d];
  const times = ([a, b], [c, d]) => [a * c - b * d, a * d + b * c];  // as complex numbers: turns
  const polar = (length, angle) => [length * Math.cos(angle), length * Math.sin(angle)];
  const sum = (vectors) => vectors.reduce((total, vector) => add(total, vector), [0, 0]);
  const wrap = (angle) => {  // into ]−π, π]
    const turns = (Math.PI - angle) / (2 * Math.PI);
    return Math.PI - 2 * Math.PI * (turns - Math.floor(turns));
  };
  const nodes = (segments) => segments.reduce(
    (places, segment) => [...places, add(places.at(-1), segment)], [[0, 0]]);
  const segmentsOf = (angles, lengths) => {
    let direction = 0;
    return angles.map((angle, i) => polar(lengths[i], direction += angle));
  };

  // Normalizers bring a vector to about length 1.  The tiny number gives zero a direction.
  const exact = ([x, y]) => {
    const size = Math.sqrt((x + 1e-150) ** 2 + y ** 2);
    return [(x + 1e-150) / size, y / size];
  };
  const learned = (layers) => (vector) =>
    layers.reduce((inputs, { weight, bias }) => weight.map((row, unit) =>
      Math.tanh(row.reduce((total, w, i) => total + w * inputs[i], 0) + bias[unit])), vector);

  const SEGMENT_WEIGHT = 0.05;  // of the segments of a rigid body, beside its span

  class Network {
    constructor({ lengths, damping, dynamic, normalize, velocityDamping, velocityDecay }) {
      Object.assign(this, { lengths, damping, dynamic, normalize, count: lengths.length });
      this.pairs = [];  // segments first, the hand last
      for (let span = 1; span <= this.count; span++) {
        for (let i = 0; i + span <= this.count; i++) this.pairs.push([i, i + span]);
      }
      this.end = this.pairs.length - 1;
      this.gain = 1 / velocityDamping;
      this.memory = velocityDecay * (velocityDamping - 1) / velocityDamping;
      const row = new Map(this.pairs.map((pair, index) => [String(pair), index]));
      const signed = (a, b) => (a < b ? [row.get(`${a},${b}`), 1] : [row.get(`${b},${a}`), -1]);
      // v_ij is computed as v_ik + v_kj for each other node k.
      this.ways = this.pairs.map(([i, j]) => [...Array(this.count + 1).keys()]
        .filter((k) => k !== i && k !== j).map((k) => [...signed(i, k), ...signed(k, j)]));
    }

    atRest(angles) {
      const segments = segmentsOf(angles, this.lengths), places = nodes(segments);
      return {
        vectors: this.pairs.map(([i, j]) => add(places[j], places[i], -1)),
        velocities: segments.map(() => [0, 0]),
      };
    }

    // What each triangle says a vector is.
    computations(vectors, row) {
      return this.ways[row].map(([a, s, b, t]) => add(add([0, 0], vectors[a], s), vectors[b], t));
    }

    // Their mean, in which the present value has the weight d − m.
    mean(vectors, row) {
      const said = this.computations(vectors, row), own = 1 - said.length / this.damping;
      return add([0, 0].map((zero, axis) => own * vectors[row][axis]), sum(said), 1 / this.damping);
    }

    // One iteration with the hand held at the target; `locks` has the angle of each locked joint,
    // and null for the others.
    iterate({ vectors, velocities }, target, locks) {
      const now = [...vectors.slice(0, this.end), target];
      const next = now.map((held, row) => (row === this.end ? held : this.mean(now, row)));
      let segments = next.slice(0, this.count);
      if (this.dynamic) {
        velocities = velocities.map((speed, i) => speed.map((old, axis) =>
          this.gain * (segments[i][axis] - now[i][axis]) + this.memory * old));
        segments = velocities.map((speed, i) => add(now[i], speed));
      }
      segments = locks.some((angle) => angle !== null) ? this.rigid(segments, locks)
        : segments.map((segment, i) => this.normalize(segment.map((part) => part / this.lengths[i]))
          .map((part) => part * this.lengths[i]));
      return { vectors: [...segments, ...next.slice(this.count)], velocities };
    }

    // Segments about locked joints are one rigid body, which is brought to where the segments and
    // their span fit best (mmc_gym.network.embodied).
    rigid(proposed, locks) {
      const { count, lengths } = this, isLocked = (joint) => joint < count && locks[joint] !== null;
      const placed = [];
      for (let first = 0; first < count; first = placed.length) {
        const own = [];
        let turn = locks[first] ?? 0, fit = [0, 0], weight = 0;
        do {
          const segment = first + own.length, length = lengths[segment];
          if (own.length) turn += locks[segment];
          own.push(polar(length, turn));
          fit = add(fit, times([own.at(-1)[0], -own.at(-1)[1]], proposed[segment]), SEGMENT_WEIGHT);
          weight += SEGMENT_WEIGHT * length ** 2;
        } while (isLocked(first + own.length));
        const span = sum(own), whole = sum(proposed.slice(first, first + own.length));
        fit = add(fit, times([span[0], -span[1]], whole));
        weight += span[0] ** 2 + span[1] ** 2;
        const isTied = first === 0 && isLocked(0);  // to the base: it cannot turn
        const direction = isTied ? [1, 0] : this.normalize(fit.map((part) => part / weight));
        placed.push(...own.map((segment) => times(segment, direction)));
      }
      return placed;
    }

    jointAngles({ vectors }) {
      const directions = vectors.slice(0, this.count).map(([x, y]) => Math.atan2(y, x));
      return directions.map((angle, i) => wrap(i ? angle - directions[i - 1] : angle));
    }
  }

  // Bend a straight arm a little if its target lies in its own line, where no iteration leaves it
  // (mmc_gym.agents.inverse_kinematics.leave_line).
  const STRAIGHT = 0.01, BEND = 0.02;
  const leaveLine = (angles, target, lengths) => {
    if (angles.slice(1).some((angle) => Math.abs(Math.sin(angle)) >= STRAIGHT)) return angles;
    const reach = lengths.reduce((a, b) => a + b), inner = 2 * Math.max(...lengths) - reach;
    const radius = Math.min(reach, Math.max(inner, Math.hypot(...target)));
    const nearest = polar(radius, Math.atan2(target[1], target[0]));
    const way = add(nearest, sum(segmentsOf(angles, lengths)), -1), distance = Math.hypot(...way);
    const across = Math.abs(times(polar(1, -angles[0]), way)[1]);
    const isStuck = distance > 1e-3 * reach && across < STRAIGHT * distance;
    return isStuck ? angles.map((angle) => angle + BEND) : angles;
  };

  globalThis.playground = { Network, add, exact, learned, leaveLine, nodes, segmentsOf, sum, wrap };
}
