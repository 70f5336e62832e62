// What a visitor does, by pointer, keys and form; and the clock.
"use strict";
{
  const { Scene, View, data } = playground;
  const FRAME = 20;  // milliseconds, a control step
  const find = (name) => document.getElementById(name);
  const scene = new Scene(data), view = new View(find("stage"), find("chart")), { stage } = view;
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  let isRunning = true, isTouched = false, isSeen = true, drag = null, announced = "";

  // After every change.  With reduced motion the end of the movement is shown at once.
  const changed = () => {
    announced = "";
    if (!drag) {  // or the picture would run away from the pointer
      view.fit(scene);
      if (still.matches && isRunning) scene.settle();
    }
    show();
  };

  const says = (body) => {
    if (!body) return "cannot act";
    const distance = scene.distance(body);
    return `${distance.toFixed(3)}, ${distance <= data.tolerance ? "there" : "not there"}`;
  };
  const policyNote = () => {
    if (!scene.bodies.ppo) return `PPO has ${scene.policy.joints} actions, one for each joint of its body.`;
    return scene.isAsTrained ? "" : "This is not the body that PPO was trained with.";
  };
  const show = () => {
    view.draw(scene);
    const chosen = find("segment").selectedIndex;
    find("length").value = scene.lengths[chosen];
    find("lock").checked = scene.locked[chosen];
    const texts = {
      "segments-value": scene.count,
      "length-value": scene.lengths[chosen].toFixed(2),
      "lock-text": `joint ${chosen + 1}, where it begins, is locked`,
      "damping-value": scene.settings.damping,
      "iterations-value": scene.settings.iterations,
      "mmc-says": says(scene.bodies.mmc),
      "ppo-says": says(scene.bodies.ppo),
      "iterations-says": `iteration ${scene.iterations}`,
      "means-says": scene.disagreement.toFixed(4),
      "policy-note": policyNote(),
      run: isRunning ? "Pause" : "Go on",
    };
    for (const name in texts) find(name).textContent = texts[name];
    if (scene.hasSettled && !announced) {  // once a movement, to screen readers
      const { centre, outer, inner } = scene.ring, [x, y] = scene.target;
      const far = Math.hypot(x - centre[0], y - centre[1]), isOut = far > outer || far < inner;
      const distance = scene.distance(scene.bodies.mmc).toFixed(3);
      announced = `At rest, ${distance} from the target${isOut ? ", which is out of reach" : ""}.`;
      find("announcer").textContent = announced;
    }
  };

  const rebuild = () => {
    find("damping").min = (scene.count + 2) / 2;  // at (N + 1)/2 it no longer converges
    find("damping").value = scene.settings.damping;
    find("segment").replaceChildren(...scene.lengths.map((_, i) => new Option(`segment ${i + 1}`)));
    view.rebuild(scene);
    changed();
  };
  const choose = (node) => { find("segment").selectedIndex = node; };
  const lengthen = (segment, length) => {
    choose(segment);
    scene.setLength(segment, Math.min(2, Math.max(0.3, Math.round(length * 100) / 100)));
    changed();
  };
  const lock = (joint) => {
    if (joint === scene.count) return;  // the hand is no joint
    choose(joint);
    scene.setLocked(joint, !scene.locked[joint]);
    changed();
  };
  const move = (target) => {
    const most = scene.reach * 1.1;
    scene.setTarget(target.map((part) => Math.min(most, Math.max(-most, part))));
    changed();
  };

  // A press on a handle takes it, a press beside them takes the target there.  A finger scrolls
  // the page beside the handles, and taps.
  stage.addEventListener("touchstart", (event) => {
    if (event.target.closest(".handle")) event.preventDefault();
  }, { passive: false });
  stage.addEventListener("pointerdown", (event) => {
    const handle = event.target.closest(".handle"), { pointerId, pointerType, clientX, clientY } = event;
    if (drag || event.button || (!handle && pointerType === "touch")) return;
    event.preventDefault();
    (handle ?? stage).setPointerCapture(pointerId);
    (handle ?? view.target).focus({ preventScroll: true });
    const isTarget = !handle || handle === view.target;
    drag = { pointerId, clientX, clientY, kind: isTarget ? "target" : "press", isFar: false };
    if (!isTarget) Object.assign(drag, { node: Number(handle.dataset.node), from: view.at(event) });
    if (!handle) move(view.at(event));
  });
  stage.addEventListener("pointermove", (event) => {
    if (event.pointerId !== drag?.pointerId) return;
    drag.isFar ||= Math.hypot(event.clientX - drag.clientX, event.clientY - drag.clientY) > 4;
    if (!drag.isFar) return;
    if (drag.kind === "target") move(view.at(event));
    if (drag.kind === "press" && drag.node > 0) {  // begin to draw the segment out
      const [a, b] = scene.nodesOf(scene.bodies.mmc).slice(drag.node - 1);
      const length = scene.lengths[drag.node - 1];
      const along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
      Object.assign(drag, { kind: "length", length, along });
    }
    if (drag.kind === "length") {
      const [x, y] = view.at(event), { from, along, node, length } = drag;
      lengthen(node - 1, length + (x - from[0]) * along[0] + (y - from[1]) * along[1]);
    }
  });
  const release = (event) => {
    if (event.pointerId !== drag?.pointerId) return;
    const { kind, node, isFar } = drag;
    drag = null;
    if (kind === "press" && !isFar && event.type === "pointerup") lock(node);
    else changed();
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("click", (event) => {
    if (event.pointerType === "touch" && !event.target.closest(".handle")) move(view.at(event));
  });

  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  stage.addEventListener("keydown", (event) => {
    const arrow = ARROWS[event.key], isPress = event.key === " " || event.key === "Enter";
    if (!arrow && !isPress) return;
    event.preventDefault();
    const { node } = event.target.dataset, by = event.shiftKey ? 0.01 : 0.1;
    if (node === undefined) {
      if (arrow) move(scene.target.map((part, axis) => part + by * arrow[axis]));
    } else if (isPress) lock(Number(node));
    else if (node > 0) lengthen(node - 1, scene.lengths[node - 1] + by * (arrow[0] + arrow[1]));
  });
  stage.addEventListener("focusin", ({ target: { dataset } }) => {
    if (dataset.node) choose(Math.min(dataset.node, scene.count - 1));
  });

  const EVENTS = { button: "click", "select-one": "change" };
  const on = (name, action) => find(name).addEventListener(EVENTS[find(name).type] ?? "input",
    ({ target }) => { action(target); changed(); });
  on("segments", ({ valueAsNumber }) => { scene.setCount(valueAsNumber); rebuild(); });
  on("segment", () => {});
  on("length", ({ valueAsNumber }) => scene.setLength(find("segment").selectedIndex, valueAsNumber));
  on("lock", ({ checked }) => scene.setLocked(find("segment").selectedIndex, checked));
  on("dynamics", ({ value }) => scene.rebuild({ dynamic: value === "dynamic" }));
  on("normalizer", ({ value }) => scene.rebuild({ normalizer: value }));
  on("damping", ({ valueAsNumber }) => scene.rebuild({ damping: valueAsNumber }));
  on("iterations", ({ valueAsNumber }) => { scene.settings.iterations = valueAsNumber; });
  on("means", ({ checked }) => { view.showsMeans = checked; });
  on("policy", ({ checked }) => { view.showsPolicy = checked; });
  on("run", () => { isRunning = !isRunning; });
  on("once", () => { isRunning = false; scene.step(1); });
  on("random", () => scene.drawTarget());
  on("restart", () => { scene.lengths = scene.lengths.map(() => 1); scene.begin(); rebuild(); });

  // Control steps of 20 ms, whatever the screen's rate; a slow page falls behind.
  let before = performance.now(), due = 0;
  const tick = (now) => {
    const isHeld = drag?.kind === "length" || still.matches || !isRunning || !isSeen;
    due = isHeld ? 0 : Math.min(due + Math.max(0, now - before), 5 * FRAME);
    before = now;
    if (due >= FRAME) {
      for (; due >= FRAME; due -= FRAME) scene.step();
      if (!isTouched && scene.hasSettled) scene.drawTarget();
      show();
    }
    requestAnimationFrame(tick);
  };
  for (const kind of ["pointerdown", "keydown", "click", "input"]) {
    document.addEventListener(kind, () => { isTouched = true; }, { capture: true });
  }
  // A busy page is handed several entries at once: the last one holds.
  new IntersectionObserver((seen) => { isSeen = seen.at(-1).isIntersecting; }).observe(stage);
  if (self !== top) {  // the page around it makes room for all of it
    document.documentElement.classList.add("is-embedded");
    const say = () => parent.postMessage({ playground: document.body.offsetHeight }, "*");
    new ResizeObserver(say).observe(document.body);
  }
  find("form").reset();  // browsers may keep what was chosen before a reload
  rebuild();
  still.addEventListener("change", changed);
  new ResizeObserver(() => { view.fit(scene); show(); }).observe(stage);
  requestAnimationFrame(tick);
  Object.assign(playground, { scene, view, show });
}
