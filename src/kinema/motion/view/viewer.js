// Plays every `.kinema-player` of the page: decode, project, draw. One animation loop, one set of settings.
(() => {
  "use strict";
  if (window.kinemaViewer) { window.kinemaViewer.scan(); return; }

  const HOME = { turn: 0.6, pitch: 0.2, zoom: 1 };
  const settings = { playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, speed: 1, sync: false,
                     follow: true, trail: true };
  const shared = { time: 0, playing: settings.playing, view: { ...HOME } };
  const players = [];
  let theme = readTheme();

  function readTheme() {
    const style = getComputedStyle(document.documentElement), colours = {};
    for (const name of ["stage", "grid", "accent", "left", "right", "middle", "shadow"])
      colours[name] = parse(style.getPropertyValue("--kinema-" + name).trim());
    return colours;
  }
  function parse(hex) { return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)); }
  function css(rgb, alpha = 1) { return `rgba(${rgb.map(Math.round).join(",")},${alpha})`; }
  function mix(a, b, t) { return a.map((v, i) => v + (b[i] - v) * t); }
  function clamp(v, low, high) { return Math.min(high, Math.max(low, v)); }

  function decode(data) {
    const bytes = Uint8Array.from(atob(data.joints), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer), centre = numbers(data.centre), scale = +data.scale;
    const out = new Float32Array(bytes.length / 2);
    for (let i = 0; i < out.length; i++) out[i] = view.getInt16(2 * i, true) * scale + centre[i % 3];
    return out;
  }
  function numbers(text) { return text.split(",").map(Number); }

  class Player {
    constructor(figure) {
      const data = figure.dataset;
      this.figure = figure;
      this.canvas = figure.querySelector("canvas");
      this.slider = figure.querySelector("input");
      this.clock = figure.querySelector(".kinema-clock");
      this.joints = decode(data);
      this.parents = numbers(data.parents);
      this.sides = numbers(data.sides);
      this.head = +data.head;
      this.stature = +data.stature;
      this.fps = +data.fps;
      this.frames = this.joints.length / this.parents.length / 3;
      this.facing = this.facingAt(0, numbers(data.face));
      this.path = this.smoothPath();
      this.own = { time: 0, playing: settings.playing, view: { ...HOME } };
      this.visible = false;
      this.slider.max = this.frames - 1;
      this.listen();
    }
    get state() { return settings.sync ? shared : this.own; }
    get duration() { return (this.frames - 1) / this.fps; }
    at(frame, joint, axis) { return this.joints[(frame * this.parents.length + joint) * 3 + axis]; }

    facingAt(frame, [rHip, lHip, rShoulder, lShoulder]) {
      const across = [0, 2].map((k) => this.at(frame, lHip, k) - this.at(frame, rHip, k)
                                     + this.at(frame, lShoulder, k) - this.at(frame, rShoulder, k));
      return Math.atan2(-across[1], across[0]);          // the figure's left is +X when it faces +Z
    }
    smoothPath() {                                        // what the camera follows: the root without its bounce
      const reach = Math.round(this.fps * 0.4), path = [];
      for (let t = 0; t < this.frames; t++) {
        let x = 0, z = 0, n = 0;
        for (let s = Math.max(0, t - reach); s <= Math.min(this.frames - 1, t + reach); s++, n++) {
          x += this.at(s, 0, 0); z += this.at(s, 0, 2);
        }
        path.push([x / n, z / n]);
      }
      return path;
    }
    listen() {
      this.figure.querySelector(".kinema-play").onclick = () => this.toggle();
      this.slider.oninput = () => { this.state.playing = false; this.seek(+this.slider.value); };
      let last = null;
      this.canvas.onpointerdown = (e) => { last = [e.clientX, e.clientY]; this.canvas.setPointerCapture(e.pointerId); };
      this.canvas.onpointermove = (e) => {
        if (!last) return;
        const view = this.state.view;
        view.turn -= (e.clientX - last[0]) * 0.01;
        view.pitch = clamp(view.pitch + (e.clientY - last[1]) * 0.008, -0.1, 1.5);
        last = [e.clientX, e.clientY];
      };
      this.canvas.onpointerup = this.canvas.onpointercancel = () => { last = null; };
      this.canvas.ondblclick = () => { this.state.view = { ...HOME }; };
      this.canvas.addEventListener("wheel", (e) => {      // an unfocused canvas lets the page scroll
        if (document.activeElement !== this.canvas && !e.ctrlKey) return;
        e.preventDefault();
        this.state.view.zoom = clamp(this.state.view.zoom * Math.exp(-e.deltaY * 0.0012), 0.25, 5);
      }, { passive: false });
      this.canvas.onkeydown = (e) => {
        if (e.key === " ") this.toggle();
        else if (e.key === "ArrowRight") this.step(1);
        else if (e.key === "ArrowLeft") this.step(-1);
        else return;
        e.preventDefault();
      };
    }
    toggle() { this.state.playing = !this.state.playing; refreshToolbars(); }
    step(by) { this.state.playing = false; this.seek(clamp(Math.round(this.frame()) + by, 0, this.frames - 1)); }
    seek(frame) { this.state.time = frame / this.fps; refreshToolbars(); }
    frame() { return clamp(this.state.time * this.fps, 0, this.frames - 1); }   // synced short clips hold their end

    pose(frame) {
      const low = Math.floor(frame), high = Math.min(low + 1, this.frames - 1), t = frame - low;
      const width = this.parents.length * 3, out = new Float32Array(width);
      for (let i = 0; i < width; i++)
        out[i] = this.joints[low * width + i] * (1 - t) + this.joints[high * width + i] * t;
      return out;
    }
    camera(frame, width, height) {
      const { turn, pitch, zoom } = this.state.view, size = this.stature;
      let [x, z] = this.path[Math.round(frame)], spread = 0;
      if (!settings.follow) {
        const xs = this.path.map((p) => p[0]), zs = this.path.map((p) => p[1]);
        const range = (v) => [Math.min(...v), Math.max(...v)];
        const [x0, x1] = range(xs), [z0, z1] = range(zs);
        x = (x0 + x1) / 2; z = (z0 + z1) / 2; spread = Math.hypot(x1 - x0, z1 - z0);
      }
      const angle = this.facing + turn, distance = (2.7 * size + 1.15 * spread) / zoom;
      const back = [Math.sin(angle) * Math.cos(pitch), Math.sin(pitch), Math.cos(angle) * Math.cos(pitch)];
      const right = [Math.cos(angle), 0, -Math.sin(angle)];
      const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
                  back[0] * right[1] - back[1] * right[0]];
      const focal = 1.85 * Math.min(width, height);
      const target = [x, 0.57 * size, z];
      const project = (px, py, pz) => {
        const d = [px - target[0], py - target[1], pz - target[2]];
        const depth = distance - (d[0] * back[0] + d[1] * back[1] + d[2] * back[2]);
        if (depth < 0.15 * size) return null;
        const k = focal / depth;
        return [width / 2 + k * (d[0] * right[0] + d[2] * right[2]),
                height / 2 - k * (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]), depth, k];
      };
      return { project, target, distance, size };
    }
    draw() {
      const ratio = window.devicePixelRatio || 1;
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
      if (!width || !height) return;
      if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
        this.canvas.width = Math.round(width * ratio);
        this.canvas.height = Math.round(height * ratio);
      }
      const ink = this.canvas.getContext("2d");
      ink.setTransform(ratio, 0, 0, ratio, 0, 0);
      ink.clearRect(0, 0, width, height);
      ink.lineCap = ink.lineJoin = "round";
      const frame = this.state.playing ? this.frame() : Math.round(this.frame());
      const camera = this.camera(frame, width, height), pose = this.pose(frame);
      drawGrid(ink, camera);
      if (settings.trail) this.drawTrail(ink, camera, frame);
      this.drawShadow(ink, camera, pose);
      this.drawBody(ink, camera, pose);
      this.report(frame);
    }
    drawTrail(ink, camera, frame) {
      const point = (t) => camera.project(this.at(t, 0, 0), 0, this.at(t, 0, 2));
      const stroke = (from, to, alpha) => {
        ink.beginPath();
        let pen = false;
        for (let t = from; t <= to; t++) {
          const p = point(t);
          if (p) pen ? ink.lineTo(p[0], p[1]) : ink.moveTo(p[0], p[1]);
          pen = Boolean(p);
        }
        ink.strokeStyle = css(theme.accent, alpha);
        ink.stroke();
      };
      const now = Math.round(frame);
      ink.lineWidth = 2;
      ink.setLineDash([2, 5]); stroke(now, this.frames - 1, 0.55);
      ink.setLineDash([]); stroke(0, now, 0.85);
    }
    drawShadow(ink, camera, pose) {
      ink.beginPath();
      for (let j = 1; j < this.parents.length; j++) {
        const a = 3 * j, b = 3 * this.parents[j];
        const p = camera.project(pose[a], 0, pose[a + 2]), q = camera.project(pose[b], 0, pose[b + 2]);
        if (p && q) { ink.moveTo(p[0], p[1]); ink.lineTo(q[0], q[1]); }
      }
      ink.lineWidth = 0.05 * this.stature * 1.85 * Math.min(this.canvas.clientWidth, this.canvas.clientHeight)
                    / camera.distance;
      ink.strokeStyle = css(theme.shadow, 0.22);
      ink.stroke();
    }
    drawBody(ink, camera, pose) {
      const points = this.parents.map((_, j) => camera.project(pose[3 * j], pose[3 * j + 1], pose[3 * j + 2]));
      const middle = points[0] ? points[0][2] : camera.distance;
      const shade = (side, depth) => {
        const base = side < 0 ? theme.left : side > 0 ? theme.right : theme.middle;
        return css(mix(base, theme.stage, clamp(0.12 + (depth - middle) / (1.6 * this.stature), 0, 0.45)));
      };
      const parts = [];
      this.parents.forEach((parent, j) => {
        const p = points[j], q = points[parent];
        if (j === 0 || !p || !q) return;
        parts.push({ depth: (p[2] + q[2]) / 2, paint: () => {
          const thick = (this.sides[j] ? 0.031 : 0.036) * this.stature * (p[3] + q[3]) / 2;
          ink.beginPath(); ink.moveTo(q[0], q[1]); ink.lineTo(p[0], p[1]);
          ink.lineCap = "butt";                           // a rim sets limbs off where they cross, not at the joints
          ink.lineWidth = thick + 2.5; ink.strokeStyle = css(theme.stage, 0.9); ink.stroke();
          ink.lineCap = "round";
          ink.lineWidth = thick; ink.strokeStyle = shade(this.sides[j], (p[2] + q[2]) / 2); ink.stroke();
        } });
      });
      const skull = this.skull(pose), h = camera.project(...skull.centre);
      if (h) parts.push({ depth: h[2], paint: () => {
        ink.beginPath(); ink.arc(h[0], h[1], skull.radius * h[3], 0, 7);
        ink.lineWidth = 2.5; ink.strokeStyle = css(theme.stage, 0.9); ink.stroke();
        ink.fillStyle = shade(0, h[2]); ink.fill();
      } });
      parts.sort((a, b) => b.depth - a.depth).forEach((part) => part.paint());
    }
    skull(pose) {                                         // the head joint sits at the skull's base
      const a = 3 * this.head, b = 3 * this.parents[this.head], radius = 0.06 * this.stature;
      const bone = [0, 1, 2].map((k) => pose[a + k] - pose[b + k]), length = Math.hypot(...bone) || 1;
      return { radius, centre: bone.map((v, k) => pose[a + k] + 0.6 * radius * v / length) };
    }
    report(frame) {
      const whole = Math.round(frame), clock = `${(whole / this.fps).toFixed(1)} / ${this.duration.toFixed(1)} s`;
      if (document.activeElement !== this.slider || this.state.playing) this.slider.value = whole;
      if (this.clock.value !== clock) this.clock.value = clock;
      this.clock.title = `frame ${whole + 1} of ${this.frames}`;
      this.figure.classList.toggle("kinema-playing", this.state.playing);
    }
  }

  function drawGrid(ink, camera) {                        // half-metre cells, fixed to the world, fading outwards
    const cell = 0.5, reach = 9, levels = 5;
    const cx = Math.round(camera.target[0] / cell), cz = Math.round(camera.target[2] / cell);
    const paths = Array.from({ length: levels }, () => new Path2D());
    const segment = (x0, z0, x1, z1) => {
      const far = Math.hypot((x0 + x1) / 2 * cell - camera.target[0], (z0 + z1) / 2 * cell - camera.target[2]);
      const level = Math.floor(levels * far / (reach * cell));
      if (level >= levels) return;
      const p = camera.project(x0 * cell, 0, z0 * cell), q = camera.project(x1 * cell, 0, z1 * cell);
      if (p && q) { paths[level].moveTo(p[0], p[1]); paths[level].lineTo(q[0], q[1]); }
    };
    for (let i = -reach; i <= reach; i++)
      for (let k = -reach; k < reach; k++) {
        segment(cx + i, cz + k, cx + i, cz + k + 1);
        segment(cx + k, cz + i, cx + k + 1, cz + i);
      }
    ink.lineWidth = 1;
    paths.forEach((path, level) => {
      ink.strokeStyle = css(theme.grid, 0.6 * (1 - level / levels));
      ink.stroke(path);
    });
  }

  function refreshToolbars() {
    const running = settings.sync ? shared.playing : players.some((p) => p.own.playing);
    document.querySelectorAll(".kinema-toolbar [data-action]").forEach((control) => {
      const action = control.dataset.action;
      if (action === "play") control.textContent = running ? "Pause all" : "Play all";
      else if (action === "speed") control.value = String(settings.speed);
      else if (action in settings) control.setAttribute("aria-pressed", String(settings[action]));
    });
  }
  function playAll(on) {
    shared.playing = on;
    players.forEach((p) => { p.own.playing = on; });
    refreshToolbars();
  }
  function seekAll(time) {
    shared.time = time;
    players.forEach((p) => { p.own.time = Math.min(time, p.duration); });
  }
  const actions = {
    play: () => playAll(!(settings.sync ? shared.playing : players.some((p) => p.own.playing))),
    sync: () => { settings.sync = !settings.sync; if (settings.sync) { seekAll(0); playAll(true); } },
    follow: () => { settings.follow = !settings.follow; },
    trail: () => { settings.trail = !settings.trail; },
    reset: () => { shared.view = { ...HOME }; players.forEach((p) => { p.own.view = { ...HOME }; }); },
  };

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) entry.target.kinema.visible = entry.isIntersecting;
  }, { rootMargin: "80px" });

  function scan() {                                       // take in the players that a later fragment has added
    document.querySelectorAll(".kinema-player[data-joints]").forEach((figure) => {
      if (figure.kinema) return;
      figure.kinema = new Player(figure);
      players.push(figure.kinema);
      seen.observe(figure);
    });
    document.querySelectorAll(".kinema-toolbar").forEach((bar) => {
      bar.onclick = (e) => {
        const action = actions[e.target.dataset.action];
        if (action) { action(); refreshToolbars(); }
      };
      bar.querySelector("select").onchange = (e) => { settings.speed = +e.target.value; refreshToolbars(); };
    });
    refreshToolbars();
  }

  let before = null;
  function tick(now) {
    const elapsed = Math.min(0.1, before === null ? 0 : (now - before) / 1000) * settings.speed;
    before = now;
    const advance = (state, end) => {                     // rest half a second on the last frame, then begin again
      if (state.playing) state.time = state.time + elapsed > end + 0.5 ? 0 : state.time + elapsed;
    };
    if (settings.sync) advance(shared, Math.max(0, ...players.map((p) => p.duration)));
    else players.forEach((p) => { if (p.visible) advance(p.own, p.duration); });
    players.forEach((p) => { if (p.visible) p.draw(); });
    requestAnimationFrame(tick);
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { theme = readTheme(); });
  window.kinemaViewer = { scan, playAll, seekAll, players, settings, refreshToolbars };
  scan();
  requestAnimationFrame(tick);
})();
