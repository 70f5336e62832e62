(() => {
  "use strict";
  const opened = [];
  addEventListener("beforeprint", () => {
    for (const one of document.querySelectorAll("details:not([open])")) { one.open = true; opened.push(one); }
  });
  addEventListener("afterprint", () => { for (const one of opened.splice(0)) one.open = false; });

  // A table says that it continues to the right where it does.
  const seen = new ResizeObserver((entries) => {
    for (const { target } of entries) target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
  });
  for (const one of document.querySelectorAll(".scroll")) seen.observe(one);

  const source = document.getElementById("replay-data");
  if (!source) return;
  const data = JSON.parse(source.textContent), { colours } = data;
  const [environment, instance, rate, agents, play, slider, clock, stage, note] =
    ["environment", "instance", "rate", "agents", "play", "time", "clock", "stage", "note"]
      .map((name) => document.getElementById(`replay-${name}`));
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  // Thousandths, of distances a tenth of these; the first and then the differences.
  const decode = (series, parts = 1000) => { let sum = 0; return series.map((change) => (sum += change) / parts); };
  const decodeAll = (many) => many.map((series) => decode(series));
  const element = (tag, className, text) => {
    const made = document.createElement(tag);
    if (className) made.className = className;
    if (text !== undefined) made.textContent = text;
    return made;
  };
  const option = (value, text) => { const made = element("option", "", text); made.value = value; return made; };

  let world, views = [], last = 1, time = 0, playing = false, before = 0, fastest = 1, target = [[0], [0]];

  function movementOf({ hand, distance, cursor, angles = [], lengths = [] }) {
    const [x, y] = decodeAll(hand);
    const speed = x.slice(1).map((value, k) => Math.hypot(value - x[k], y[k + 1] - y[k]) / world.step);
    return {
      x, y, speed, lengths, distance: decode(distance, 10000), angles: decodeAll(angles),
      cursor: cursor && decodeAll(cursor),
    };
  }

  function fillInstances() {
    instance.replaceChildren(...data.scenes[environment.value].map((one) => (
      option(one.instance, `${one.instance}${one.failed.length ? `: ${one.failed.join(", ")} failed` : ""}`))));
  }

  function build(atEnd) {
    const shown = data.scenes[environment.value][instance.selectedIndex];
    world = data.worlds[environment.value];
    const chosen = [...agents.querySelectorAll("input")].filter((box) => box.checked).map((box) => box.value);
    target = decodeAll(shown.target);
    views = chosen.filter((name) => Object.hasOwn(shown.agents, name)).map((name) => {
      const figure = element("figure", "view"), arm = element("canvas", "arm"), speed = element("canvas", "speed");
      const readout = element("p", "readout");
      for (const [canvas, what] of [[arm, "arm"], [speed, "hand speed"]]) {
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${what} of ${name}`);
      }
      const heading = element("figcaption", "", name);
      heading.title = name;
      figure.append(heading, arm, speed, readout);
      return { name, figure, arm, speed, readout, movement: movementOf(shown.agents[name]) };
    });
    stage.replaceChildren(...views.map((view) => view.figure));
    last = Math.max(1, ...views.map((view) => view.movement.x.length - 1));
    fastest = Math.max(0.1, ...views.flatMap((view) => view.movement.speed));
    slider.max = last;
    time = atEnd ? last : Math.min(time, last);
    const missing = chosen.filter((name) => !Object.hasOwn(shown.agents, name)).join(", ");
    note.textContent = [
      chosen.length === 0 && "Choose an agent.",
      missing && `Not kept: the path of ${missing}, as each has those of the first episodes and of its first failures.`,
      views.some((view) => view.movement.cursor) &&
        "Agents see a cursor, the square on the dashed path, in place of the hand: distance and success are the cursor's.",
    ].filter(Boolean).join(" ");
    draw();
  }

  function prepare(canvas) {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineCap = pen.lineJoin = "round";
    return { pen, width, height };
  }
  const at = (series, moment) => {
    const k = Math.min(Math.floor(moment), series.length - 1), next = Math.min(k + 1, series.length - 1);
    return series[k] + (series[next] - series[k]) * (moment - Math.floor(moment));
  };

  function drawArm(view) {
    const { pen, width } = prepare(view.arm), { movement } = view;
    const reach = Math.max(world.lengths.reduce((a, b) => a + b, 0), movement.lengths.reduce((a, b) => a + b, 0));
    const scale = width / (2.16 * reach), unit = width / 340;
    const place = (x, y) => [width / 2 + x * scale, width / 2 - y * scale];
    const moment = Math.min(time, movement.x.length - 1);
    const stroke = (points, colour, line) => {
      pen.strokeStyle = colour; pen.lineWidth = line; pen.beginPath();
      points.forEach((point, k) => (k ? pen.lineTo(...point) : pen.moveTo(...point)));
      pen.stroke();
    };
    const disc = (point, radius, fill, edge, line) => {
      pen.beginPath(); pen.arc(...point, radius, 0, 2 * Math.PI);
      if (fill) { pen.fillStyle = fill; pen.fill(); }
      if (edge) { pen.strokeStyle = edge; pen.lineWidth = line; pen.stroke(); }
    };
    pen.fillStyle = colours.background; pen.fillRect(0, 0, width, width);
    disc(place(0, 0), reach * scale, colours.reachable, colours.border, 1.2);

    const nodes = [[0, 0]];
    let turn = 0;
    movement.angles.forEach((series, k) => {
      turn += at(series, moment);
      const [x, y] = nodes[nodes.length - 1];
      nodes.push([x + movement.lengths[k] * Math.cos(turn), y + movement.lengths[k] * Math.sin(turn)]);
    });
    const pixels = nodes.map(([x, y]) => place(x, y));
    const thick = (k) => unit * (12 - (7 * k) / Math.max(1, movement.angles.length));
    for (let k = pixels.length - 2; k >= 0; k--) {
      stroke([pixels[k], pixels[k + 1]], colours.outline, thick(k) + 2.4 * unit);
      stroke([pixels[k], pixels[k + 1]], colours.rod, thick(k));
    }
    pixels.slice(0, -1).forEach((point, k) => disc(point, 0.34 * thick(k), colours.reachable, colours.outline, 1.4 * unit));

    const past = Math.floor(moment), way = [];
    for (let k = 0; k <= past; k++) way.push(place(movement.x[k], movement.y[k]));
    const hand = place(at(movement.x, moment), at(movement.y, moment));
    stroke([...way, hand], colours.trace, 1.3 * unit);
    way.forEach((point) => disc(point, 1.7 * unit, colours.trace));
    disc(way[0], 4 * unit, colours.reachable, colours.outline, 1.4 * unit);
    disc(hand, 4 * unit, colours.outline, colours.reachable, 1.2 * unit);
    if (movement.cursor) {
      const [cx, cy] = movement.cursor, now = place(at(cx, moment), at(cy, moment)), half = 4.5 * unit, side = 2 * half;
      pen.setLineDash([5 * unit, 3 * unit]);
      stroke([...cx.slice(0, past + 1).map((x, k) => place(x, cy[k])), now], colours.outline, 1.3 * unit);
      pen.setLineDash([]);
      pen.fillStyle = colours.reachable; pen.fillRect(now[0] - half, now[1] - half, side, side);
      pen.strokeStyle = colours.outline; pen.lineWidth = 2 * unit; pen.strokeRect(now[0] - half, now[1] - half, side, side);
    }

    const goal = target.map((series) => at(series, Math.min(moment, series.length - 1)));
    const centre = place(...goal), radius = Math.max(world.near * scale, 3 * unit);
    const distance = at(movement.distance, moment);
    for (const [colour, line] of [[colours.reachable, 4 * unit], [colours.target, 2 * unit]]) {
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        const [near, far] = [radius + 2 * unit, radius + 9 * unit];
        stroke([[centre[0] + near * dx, centre[1] + near * dy], [centre[0] + far * dx, centre[1] + far * dy]], colour, line);
      }
      disc(centre, radius, null, colour, line);
      if (distance <= world.near) disc(centre, radius + 5.5 * unit, null, colour, line);
    }
    view.readout.textContent = `distance ${movement.cursor ? "of the cursor " : ""}${distance.toFixed(3)}${distance <= world.near ? " ✓ there" : ""}`;
  }

  function drawSpeed(view) {
    const { pen, width, height } = prepare(view.speed), { speed } = view.movement;
    const left = 26, bottom = height - 30, right = width - 6, top = 16;
    const x = (k) => left + ((right - left) * k) / last, y = (value) => bottom - ((bottom - top) * value) / fastest;
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = "#56616f"; pen.strokeStyle = "#8a95a3"; pen.lineWidth = 1;
    pen.beginPath(); pen.moveTo(left, top); pen.lineTo(left, bottom); pen.lineTo(right, bottom); pen.stroke();
    pen.textAlign = "left"; pen.fillText("speed [lengths/s]", 0, 10);
    pen.textAlign = "right";
    const tick = fastest > 8 ? 4 : fastest > 4 ? 2 : fastest > 1.5 ? 1 : 0.5;
    for (let value = 0; value <= fastest; value += tick) pen.fillText(String(value), left - 4, y(value) + 4);
    const seconds = last * world.step, every = seconds > 4 ? 2 : seconds > 1.2 ? 0.5 : 0.2;
    for (let second = 0; second <= seconds + 1e-9; second += every) {
      const place = x(second / world.step);
      pen.textAlign = second === 0 ? "left" : second > seconds - every / 2 ? "right" : "center";
      pen.fillText(`${+second.toFixed(1)}${second === 0 ? " s" : ""}`, place, bottom + 13);
    }
    pen.strokeStyle = colours.outline; pen.lineWidth = 1.6; pen.beginPath();
    speed.forEach((value, k) => (k ? pen.lineTo(x(k + 0.5), y(value)) : pen.moveTo(x(0.5), y(value))));
    pen.stroke();
    pen.strokeStyle = colours.target; pen.lineWidth = 1.5; pen.setLineDash([4, 3]);
    pen.beginPath(); pen.moveTo(x(time), top); pen.lineTo(x(time), bottom); pen.stroke(); pen.setLineDash([]);
    const now = Math.min(speed.length - 1, Math.max(0, time - 0.5));
    pen.fillStyle = colours.target; pen.beginPath(); pen.arc(x(now + 0.5), y(at(speed, now)), 3.2, 0, 2 * Math.PI); pen.fill();
  }

  function draw() {
    slider.value = Math.round(time);
    const text = `${(time * world.step).toFixed(2)} s`;
    clock.textContent = text;
    slider.setAttribute("aria-valuetext", text);
    for (const view of views) { drawArm(view); drawSpeed(view); }
  }
  function setPlaying(on) {
    playing = on;
    play.textContent = on ? "❚❚ Pause" : "▶ Play";
    if (!on) return;
    if (time >= last) time = 0;
    before = performance.now();
    requestAnimationFrame(frame);
  }
  function frame(now) {
    if (!playing) return;
    // A frame may have begun before the click that it is to show.
    time = Math.min(last, time + (Math.max(0, now - before) / 1000 / world.step) * Number(rate.value));
    before = now;
    if (still.matches) time = Math.ceil(time);
    draw();
    if (time >= last) setPlaying(false); else requestAnimationFrame(frame);
  }
  const seek = (moment) => { setPlaying(false); time = Math.max(0, Math.min(last, moment)); draw(); };

  environment.replaceChildren(...Object.keys(data.scenes).map((key) => option(key, key)));
  fillInstances();
  for (const name of data.agents) {
    const label = element("label"), box = element("input");
    box.type = "checkbox"; box.value = name; box.checked = data.chosen.includes(name);
    label.append(box, name);
    agents.append(label);
  }
  environment.addEventListener("change", () => { setPlaying(false); fillInstances(); build(true); });
  instance.addEventListener("change", () => { setPlaying(false); build(true); });
  agents.addEventListener("change", () => build(false));
  for (const link of document.querySelectorAll("button.show")) {
    link.addEventListener("click", () => {
      setPlaying(false);
      environment.value = link.dataset.scenario;
      fillInstances();
      instance.value = link.dataset.instance;
      build(true);
      document.getElementById("replay-section").scrollIntoView();
    });
  }
  play.addEventListener("click", () => setPlaying(!playing));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  stage.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: Math.ceil(time) - 1, ArrowRight: Math.floor(time) + 1, Home: 0, End: last };
    if (event.key === " ") setPlaying(!playing);
    else if (event.key in moves) seek(moves[event.key]);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(draw).observe(stage);
  build(true);
})();
