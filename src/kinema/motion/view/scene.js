// A view of one or several tracks on their ground: colours of the page, the camera, the grid.
(() => {
  "use strict";
  const NAMES = ["stage", "grid", "accent", "left", "right", "middle", "shadow", "stands", "kept", "made",
                 "overlay-0", "overlay-1", "overlay-2", "overlay-3", "overlay-4", "overlay-5"];
  let theme = readTheme();

  function readTheme() {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(NAMES.map((name) => [name, parse(style.getPropertyValue("--kinema-" + name).trim())]));
  }
  function parse(hex) { return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)); }
  function css(rgb, alpha = 1) { return `rgba(${rgb.map(Math.round).join(",")},${alpha})`; }
  function lit(rgb, light) {                              // 0: in its own shade, to 1: a gleam
    const strength = 0.55 + 0.66 * light;
    return strength < 1 ? rgb.map((v) => v * strength) : mix(rgb, [255, 255, 255], 0.9 * (strength - 1));
  }
  const pairs = new WeakMap();                            // of one colour, a lighter one for left and a darker for right
  function sided(rgb, side) {
    if (!pairs.has(rgb)) pairs.set(rgb, [mix(rgb, [255, 255, 255], 0.22), rgb, mix(rgb, [0, 0, 0], 0.2)]);
    return pairs.get(rgb)[side + 1];
  }
  const tones = new WeakMap();                            // of each colour, by fog and light: written once
  function tone(rgb, fog, light) {
    const [step, strength] = [Math.round(24 * fog), Math.round(32 * Math.max(light, 0))], key = step * 64 + strength;
    if (!tones.has(rgb)) tones.set(rgb, []);
    return tones.get(rgb)[key] ??= css(mix(lit(rgb, strength / 32), theme.stage, step / 24));
  }
  function mix(a, b, t) { return a.map((v, i) => v + (b[i] - v) * t); }

  function camera(tracks, time, view, follow, width, height) {
    const size = Math.max(...tracks.map((track) => track.stature));
    const spots = follow ? tracks.map((track) => track.centre(time)) : tracks.flatMap((track) => track.path);
    const [x0, x1] = range(spots.map((p) => p[0])), [z0, z1] = range(spots.map((p) => p[1]));
    const spread = Math.hypot(x1 - x0, z1 - z0), { turn, pitch, zoom } = view;
    const angle = tracks[0].facing + turn, distance = (2.7 * size + 1.15 * spread) / zoom;
    const back = [Math.sin(angle) * Math.cos(pitch), Math.sin(pitch), Math.cos(angle) * Math.cos(pitch)];
    const right = [Math.cos(angle), 0, -Math.sin(angle)];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
                back[0] * right[1] - back[1] * right[0]];
    const focal = 1.85 * Math.min(width, height);
    const target = [(x0 + x1) / 2, 0.57 * size, (z0 + z1) / 2];
    const project = (px, py, pz) => {
      const d = [px - target[0], py - target[1], pz - target[2]];
      const depth = distance - (d[0] * back[0] + d[1] * back[1] + d[2] * back[2]);
      if (depth < 0.15 * size) return null;
      const k = focal / depth;
      return [width / 2 + k * (d[0] * right[0] + d[2] * right[2]),
              height / 2 - k * (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]), depth, k];
    };
    return { project, target, distance, size, focal };
  }
  function range(values) { return [Math.min(...values), Math.max(...values)]; }

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

  // What a body is painted in: left and right; an edit kept and made; several of one player each its own.
  function paints(track, index, count) {
    if (count > 1) return () => theme["overlay-" + index % 6];
    if (track.kept.length) return (frame) => track.keeps(Math.round(frame)) ? theme.kept : theme.made;
    return null;
  }

  function draw(ink, tracks, time, view, settings, width, height) {
    ink.clearRect(0, 0, width, height);
    ink.lineCap = ink.lineJoin = "round";
    const eye = camera(tracks, time, view, settings.follow, width, height), parts = [];
    drawGrid(ink, eye);
    tracks.forEach((track, i) => {
      const frame = settings.whole ? Math.round(track.frame(time)) : track.frame(time);
      const pose = track.pose(frame), paint = paints(track, i, tracks.length);
      if (settings.trail)
        track.drawTrail(ink, eye, frame, (at, alpha) => css(paint ? paint(at) : theme.accent, alpha));
      const body = kinema.figure.pieces(track, pose);
      kinema.figure.drawShadow(ink, eye, body, css(theme.shadow, 0.22));
      kinema.figure.drawContacts(track, ink, eye, pose, frame, css(theme.stands, 0.9));
      const base = (side) => paint ? sided(paint(frame), side) : [theme.left, theme.middle, theme.right][side + 1];
      const colour = (side, fog, light) => tone(base(side), fog, light);
      parts.push(...kinema.figure.parts(track, ink, eye, body, pose, colour));
    });
    parts.sort((a, b) => b.depth - a.depth).forEach((part) => part.paint());
  }

  let shade = 0;                                          // counts changes of the page's colours
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { theme = readTheme(); shade++; });
  Object.assign(kinema, { draw, shade: () => shade });
})();
