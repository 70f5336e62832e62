// A body: rods and servos with the parameters of mmc_gym's arm, simulated in a few lines.
//
// The joints obey  M q̈ + c = τ,  with M from the masses of rods and drives.  A servo asks for a speed
// towards its goal, and has a largest torque to get it; a locked joint is held by what it takes.
"use strict";
{
  const { segmentsOf, sum, wrap } = playground;
  const SWEEPS = 40;  // over the joints, to find the impulses of their servos

  class Body {
    constructor({ lengths, angles, physics }) {
      Object.assign(this, { angles: [...angles], speeds: angles.map(() => 0), physics });
      this.resize(lengths);
    }

    resize(lengths) {
      this.lengths = lengths;
      const { driveInertia, torque, stretched } = this.physics, last = lengths.length - 1;
      let beyond = 0, moment = 0, inertia = 0;  // of the stretched arm from a joint on
      this.inertias = [];
      for (let i = last; i >= 0; i--) {
        const length = lengths[i];
        inertia += 2 * length * moment + beyond * length ** 2 + length ** 2 / 3;
        moment += beyond * length + length / 2;
        beyond += 1;
        this.inertias[i] = length ** 2 / 12 + driveInertia * inertia;
      }
      this.torque = torque * inertia / stretched;  // a larger arm has stronger servos
      // What two segments' directions have to do with each other: the rods that both move.
      this.coupling = lengths.map((a, j) => lengths.map((b, k) =>
        a * b * (last - Math.max(j, k) + (j === k ? 0.25 : 0.5))));
    }

    get hand() { return sum(segmentsOf(this.angles, this.lengths)); }

    // Let the servos follow joint angles for one control step, the short way round.
    follow(goals, locked) {
      const { substep, substeps, servoGain, speedLimit } = this.physics;
      const asked = goals.map((goal, i) => this.angles[i] + wrap(goal - this.angles[i]));
      const gain = -Math.expm1(-servoGain * substep) / substep;
      for (let step = 0; step < substeps; step++) {
        this.angles = this.angles.map((angle, i) => angle + substep * this.speeds[i]);
        const wanted = this.angles.map((angle, i) => (locked[i] ? 0
          : Math.min(speedLimit, Math.max(-speedLimit, gain * (asked[i] - angle)))));
        this.speeds = this.pushed(wanted, locked);
      }
    }

    // The joints' speeds after a substep in which the servos ask for `wanted`.
    pushed(wanted, locked) {
      const { substep } = this.physics, joints = [...wanted.keys()];
      let direction = 0, turning = 0;
      const theta = this.angles.map((angle) => direction += angle);
      const omega = this.speeds.map((speed) => turning += speed);
      const M = joints.map((j) => joints.map((k) => this.coupling[j][k]
        * Math.cos(theta[j] - theta[k]) + (j === k ? this.inertias[j] : 0)));
      const c = joints.map((j) => joints.reduce((total, k) => total
        + this.coupling[j][k] * Math.sin(theta[j] - theta[k]) * omega[k] ** 2, 0));
      // A joint turns all segments from it on.
      for (let j = joints.length - 2; j >= 0; j--) {
        c[j] += c[j + 1];
        for (const k of joints) M[j][k] += M[j + 1][k];
      }
      for (const row of M) for (let k = joints.length - 2; k >= 0; k--) row[k] += row[k + 1];
      const A = inverse(M), bound = substep * this.torque, impulses = joints.map(() => 0);
      const speeds = this.speeds.map((speed, j) =>
        speed - substep * c.reduce((total, force, k) => total + A[j][k] * force, 0));
      for (let sweep = 0; sweep < SWEEPS; sweep++) {
        for (const j of joints) {
          const most = locked[j] ? Infinity : bound, before = impulses[j];
          const needed = before + (wanted[j] - speeds[j]) / A[j][j];
          impulses[j] = Math.min(most, Math.max(-most, needed));
          for (const k of joints) speeds[k] += A[k][j] * (impulses[j] - before);
        }
      }
      return speeds.map((speed, j) => (locked[j] ? 0 : speed));
    }
  }

  // Of a symmetric and positive definite matrix, by Gauss and Jordan.
  const inverse = (matrix) => {
    const rows = matrix.map((row, i) => [...row, ...row.map((_, k) => Number(i === k))]);
    for (const p of matrix.keys()) {
      rows[p] = rows[p].map((value) => value / rows[p][p]);
      for (const i of matrix.keys()) {
        const factor = rows[i][p];
        if (i !== p) rows[i] = rows[i].map((value, k) => value - factor * rows[p][k]);
      }
    }
    return rows.map((row) => row.slice(matrix.length));
  };

  Object.assign(playground, { Body });
}
