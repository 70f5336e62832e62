// The scene: a target, the network and its body, and the policy with a body like it.
"use strict";
{
  const { Network, Policy, Body, add, exact, learned, leaveLine, nodes, observe, segmentsOf } = playground;
  const TRAIL = 100, HISTORY = 250;  // control steps
  const STILL = 25;  // control steps without motion, after which the network has settled

  class Scene {
    constructor(data) {
      this.data = data;
      this.policy = new Policy(data.policy);
      this.normalizers = { exact };
      for (const name in data.normalizers) this.normalizers[name] = learned(data.normalizers[name]);
      this.settings = { dynamic: true, normalizer: "exact", damping: 4, iterations: 3 };
      this.target = [-1, 1.5];
      this.lengths = [1, 1, 1];
      this.begin();
    }

    get count() { return this.lengths.length; }
    get reach() { return this.lengths.reduce((a, b) => a + b); }
    // What the hand can reach: a ring.  A locked joint makes two segments one link, and the first
    // joint, if it is locked, moves the centre.
    get ring() {
      const links = [];
      segmentsOf(this.bodies.mmc.angles, this.lengths).forEach((segment, i) =>
        links.push(i && this.locked[i] ? add(links.pop(), segment) : segment));
      const centre = this.locked[0] ? links.shift() : [0, 0];
      const lengths = links.map((link) => Math.hypot(...link));
      const outer = lengths.reduce((a, b) => a + b, 0);
      return { centre, outer, inner: Math.max(0, 2 * Math.max(0, ...lengths) - outer) };
    }

    // A target anywhere in the ring.
    drawTarget() {
      const { centre, outer, inner } = this.ring, bearing = 2 * Math.PI * Math.random();
      const radius = Math.sqrt(inner ** 2 + (outer ** 2 - inner ** 2) * Math.random());
      this.setTarget(add(centre, [Math.cos(bearing), Math.sin(bearing)], radius));
    }

    get hasSettled() { return this.still >= STILL; }
    get isAsTrained() {
      return this.lengths.every((length) => length === 1) && !this.locked.includes(true);
    }

    // Both arms in the same bent posture, without locks.  The policy may have other joints.
    begin() {
      const { lengths, count, data: { physics } } = this;
      const angles = lengths.map((_, i) => (i ? 1.2 / (count - 1) : 0.3));
      this.locked = angles.map(() => false);
      this.bodies = { mmc: new Body({ lengths, angles, physics }) };
      if (count === this.policy.joints) this.bodies.ppo = new Body({ lengths, angles, physics });
      this.history = { mmc: [], ppo: [] };
      this.rebuild();
    }

    setCount(count) {
      const before = this.reach;
      this.lengths = Array.from({ length: count }, (_, i) => this.lengths[i] ?? 1);
      this.target = this.target.map((part) => (part * this.reach) / before);
      this.settings.damping = count + 1;
      this.begin();
    }

    setLength(segment, length) {
      this.lengths = this.lengths.with(segment, length);
      for (const body of Object.values(this.bodies)) body.resize(this.lengths);
      this.rebuild();
    }

    setLocked(joint, isLocked) {
      this.locked[joint] = isLocked;
      this.locks[joint] = isLocked ? this.bodies.mmc.angles[joint] : null;
      for (const body of Object.values(this.bodies)) if (isLocked) body.speeds[joint] = 0;
      this.change();
    }

    setTarget(target) {
      this.target = target;
      this.change();
    }

    // A network with these settings, that starts from where its body is.
    rebuild(settings = {}) {
      const { damping, dynamic, normalizer } = Object.assign(this.settings, settings);
      const normalize = this.normalizers[normalizer], { angles } = this.bodies.mmc;
      this.network = new Network(
        { lengths: this.lengths, damping, dynamic, normalize, ...this.data.network });
      this.state = this.network.atRest(angles);
      this.locks = this.locked.map((isLocked, i) => (isLocked ? angles[i] : null));
      this.change();
    }

    change() {
      const angles = this.network.jointAngles(this.state);
      const bent = leaveLine(angles, this.target, this.lengths);
      if (bent !== angles) {
        this.state = this.network.atRest(bent.map((angle, i) => this.locks[i] ?? angle));
      }
      this.iterations = this.still = 0;
      this.trails = { mmc: [], ppo: [] };
    }

    // One control step: some iterations of the network, then the bodies follow.
    step(iterations = this.settings.iterations) {
      for (let k = 0; k < iterations; k++) {
        this.state = this.network.iterate(this.state, this.target, this.locks);
      }
      this.iterations += iterations;
      const { mmc, ppo } = this.bodies, before = mmc.hand;
      mmc.follow(this.network.jointAngles(this.state), this.locked);
      if (ppo) ppo.follow(this.goals(ppo), this.locked);
      for (const [name, body] of Object.entries(this.bodies)) {
        this.trails[name] = [...this.trails[name], body.hand].slice(-TRAIL);
        this.history[name] = [...this.history[name], this.distance(body)].slice(-HISTORY);
      }
      const moved = Math.hypot(mmc.hand[0] - before[0], mmc.hand[1] - before[1]);
      this.still = moved < 1e-4 ? this.still + 1 : 0;
    }

    // Steps without a picture, until the network has settled: at least 2 s, at most 10.
    settle() {
      for (let k = 0; k < 500 && (k < 100 || !this.hasSettled); k++) this.step();
    }

    // The policy's actions are angles ahead of the present ones.
    goals({ angles, speeds, hand }) {
      const { physics: { speedLimit, servoGain }, near } = this.data, { target } = this;
      const relative = speeds.map((speed) => Math.min(1, Math.max(-1, speed / speedLimit)));
      const action = this.policy.act(observe({ angles, speeds: relative, hand, target, near }));
      return angles.map((angle, i) => angle + (speedLimit / servoGain) * action[i]);
    }

    distance({ hand }) { return Math.hypot(hand[0] - this.target[0], hand[1] - this.target[1]); }
    nodesOf({ angles, lengths }) { return nodes(segmentsOf(angles, lengths)); }

    // Mean distance of what the triangles say from the vectors: 0 when all agree.
    get disagreement() {
      const { vectors } = this.state, apart = vectors.flatMap(([x, y], row) =>
        this.network.computations(vectors, row).map(([a, b]) => Math.hypot(a - x, b - y)));
      return apart.reduce((a, b) => a + b) / apart.length;
    }
  }

  Object.assign(playground, { Scene });
}
