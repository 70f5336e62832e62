// The picture: an SVG of the scene, whose handles are elements that can be focused and named.
"use strict";
{
  const { add, nodes } = playground;
  const MARGIN = 1.14;  // of the picture beyond the reach
  const PATHS = ["diagonals", "spread", "ppo-trail", "ppo", "mmc-trail", "mmc", "network"];

  const element = (parent, tag, attributes = {}) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    return parent.appendChild(set(made, attributes));
  };
  const set = (shape, attributes) => {
    for (const [name, value] of Object.entries(attributes)) shape.setAttribute(name, value);
    return shape;
  };
  const path = (points) => points.map(([x, y], i) =>
    `${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`).join("");

  class View {
    constructor(stage, chart) {
      Object.assign(this, { stage, chart, showsMeans: false, showsPolicy: true, shapes: {} });
      this.shapes.ring = element(stage, "path", { class: "ring" });
      this.axes = element(stage, "g", { class: "axes", "aria-hidden": true });
      for (const name of PATHS) this.shapes[name] = element(stage, "path", { class: name });
      this.numbers = element(stage, "g", { class: "numbers", "aria-hidden": true });
      this.handles = element(stage, "g");
      for (const name of ["mmc-line", "ppo-line"]) {
        this.shapes[name] = element(chart, "path", { class: name });
      }
      this.target = this.handle(stage, "target", "slider",
        "Target. Arrow keys move it, with Shift by less.");
      element(this.target, "path", { d: "M-15 0H15M0 -15V15" });
    }

    // A group to be dragged or pressed; its first circle is what a finger meets.
    handle(parent, kind, role, label) {
      const made = element(parent, "g",
        { class: `handle ${kind}`, role, tabindex: 0, "aria-label": label });
      element(made, "circle", { class: "hit", r: 22 });
      return made;
    }

    // Node i is joint i + 1, and the end of segment i.
    rebuild(scene) {
      this.handles.replaceChildren();
      this.numbers.replaceChildren();
      const lengthOf = (node) => `Arrow keys: length of segment ${node}.`;
      this.nodes = scene.lengths.map((_, node) => {
        const label = `Joint ${node + 1}. Space: lock or free it. ${node ? lengthOf(node) : ""}`;
        const made = this.handle(this.handles, "joint", node ? "slider" : "button", label);
        element(made, "circle", { class: "free" });
        element(made, "path", { class: "locked", d: "M-8 -8H8V8H-8ZM-8 -8L8 8M-8 8L8 -8" });
        return made;
      });
      const end = `End of segment ${scene.count}. ${lengthOf(scene.count)}`;
      this.nodes.push(this.handle(this.handles, "grip", "slider", end));
      element(this.nodes.at(-1), "path", { d: "M-7 -5L-12 0L-7 5M7 -5L12 0L7 5M-12 0H12" });
      this.nodes.forEach((made, node) => { made.dataset.node = node; });
      this.labels = scene.lengths.map((_, i) => {
        const label = element(this.numbers, "text");
        label.textContent = i + 1;
        return label;
      });
      this.fit(scene);
    }

    // Make the whole reach visible.
    fit(scene) {
      this.size = this.stage.clientWidth || 300;
      this.scale = this.size / (2 * MARGIN * scene.reach);
      const corner = -this.size / 2, spacing = this.scale * Math.min(...scene.lengths);
      set(this.stage, { viewBox: `${corner} ${corner} ${this.size} ${this.size}` });
      this.stage.style.setProperty("--thick", `${Math.min(14, Math.max(8, spacing / 3))}px`);
      this.stage.style.setProperty("--hit", `${Math.min(22, Math.max(12, spacing / 2))}px`);
      this.numbers.style.display = spacing < 28 ? "none" : "";
      this.drawAxes(scene.reach);
    }

    // Coordinates at the picture's edges.
    drawAxes(reach) {
      const edge = this.size / 2, every = 2 ** Math.max(0, Math.ceil(Math.log2(reach / 4)));
      const write = (x, y, words) => {
        element(this.axes, "text", { x, y }).textContent = words;
      };
      this.axes.replaceChildren();
      for (let at = every * Math.ceil(-reach / every); at <= reach; at += every) {
        write(at * this.scale, edge - 6, at);
        write(12 - edge, -at * this.scale + 4, at);
      }
      write(edge - 66, edge - 20, "x [segment lengths]");
      write(66 - edge, 14 - edge, "y [segment lengths]");
    }

    place([x, y]) { return [x * this.scale, -y * this.scale]; }

    // Where in the scene a pointer is.
    at({ clientX, clientY }) {
      const { left, top, width, height } = this.stage.getBoundingClientRect();
      return [(clientX - left - width / 2) / this.scale, (top + height / 2 - clientY) / this.scale];
    }

    draw(scene) {
      const place = (points) => points.map((point) => this.place(point));
      const { bodies: { mmc, ppo }, trails, state, count } = scene, policy = this.showsPolicy && ppo;
      const body = place(scene.nodesOf(mmc)), other = policy ? place(scene.nodesOf(ppo)) : [];
      const own = nodes(state.vectors.slice(0, count));
      const drawn = { mmc: body, ppo: other, network: place(own), "mmc-trail": place(trails.mmc),
        "ppo-trail": policy ? place(trails.ppo) : [] };
      for (const name in drawn) set(this.shapes[name], { d: path(drawn[name]) });
      const { centre, outer, inner } = scene.ring, [x, y] = this.place(centre);
      const circle = (r) => `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0Z`;
      set(this.shapes.ring, { d: circle(outer * this.scale) + circle(inner * this.scale) });
      this.drawMeans(scene, own);
      this.drawHandles(scene, body);
      this.drawHistory("mmc", scene.history.mmc);
      this.drawHistory("ppo", policy ? scene.history.ppo : []);
    }

    // The network's vectors from the nodes where they begin; at their tips, what each triangle says.
    drawMeans(scene, from) {
      const diagonals = [], spread = [], { network, state: { vectors } } = scene;
      this.stage.classList.toggle("shows-means", this.showsMeans);
      network.pairs.slice(0, this.showsMeans ? undefined : 0).forEach(([start], row) => {
        const base = from[start], tip = this.place(add(base, vectors[row]));
        if (row >= scene.count) diagonals.push(path([this.place(base), tip]));
        for (const said of network.computations(vectors, row)) {
          spread.push(path([tip, this.place(add(base, said))]), "m-2 0a2 2 0 1 0 4 0a2 2 0 1 0 -4 0");
        }
      });
      set(this.shapes.diagonals, { d: diagonals.join("") });
      set(this.shapes.spread, { d: spread.join("") });
    }

    drawHandles(scene, body) {
      const [before, tip] = body.slice(-2), along = Math.atan2(tip[1] - before[1], tip[0] - before[0]);
      const beyond = add(tip, [36 * Math.cos(along), 36 * Math.sin(along)]);
      this.nodes.forEach((made, node) => {
        const isGrip = node === scene.count, [x, y] = isGrip ? beyond : body[node];
        const turn = isGrip ? (along * 180) / Math.PI : 0, isLocked = scene.locked[node] ?? false;
        set(made, { transform: `translate(${x} ${y}) rotate(${turn})` });
        made.classList.toggle("is-locked", isLocked);
        if (node === 0) return set(made, { "aria-pressed": isLocked });
        const length = scene.lengths[node - 1], lock = isLocked ? ", joint locked" : "";
        set(made, { "aria-valuemin": 0.3, "aria-valuemax": 2, "aria-valuenow": length,
          "aria-valuetext": `length ${length.toFixed(2)}${lock}` });
      });
      this.labels.forEach((label, i) => {
        const [x, y] = add(body[i], body[i + 1]);
        set(label, { x: x / 2, y: y / 2 });
      });
      const [x, y] = this.place(scene.target), [a, b] = scene.target.map((part) => part.toFixed(2));
      set(this.target, { transform: `translate(${x} ${y})`, "aria-valuenow": a,
        "aria-valuetext": `x ${a}, y ${b}` });
    }

    // Distances on a logarithmic scale: 25 for each tenth, from 10 down to 0.001.
    drawHistory(name, distances) {
      const height = (distance) => Math.min(100, 25 - 25 * Math.log10(distance + 1e-9));
      const ago = (i) => 2 * (distances.length - 1 - i);
      const points = distances.map((one, i) => [500 - ago(i), Math.max(0, height(one))]);
      set(this.shapes[`${name}-line`], { d: path(points) });
    }
  }

  Object.assign(playground, { View });
}
