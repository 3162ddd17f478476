// A body with volume: trunk, tapered limbs, head, hands and feet, each shaded as the round thing that it stands for.
(() => {
  "use strict";
  const LIGHT = [-0.42, -0.58, 0.7];                      // from the upper left of the screen, towards the viewer
  const STOPS = [-1, -0.6, 0, 0.6, 1];
  const ROUND = Array.from({ length: 16 }, (_, i) => [Math.cos(Math.PI * i / 8), Math.sin(Math.PI * i / 8)]);
  const COARSE = ROUND.filter((_, i) => i % 2 === 0);

  function towards(a, b, by) {                            // from a, `by` metres further the way that a lies from b
    const way = a.map((v, k) => v - b[k]), length = Math.hypot(...way) || 1;
    return a.map((v, k) => v + by * way[k] / length);
  }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }

  // What a body is made of: balls [x, y, z, radius] that a skin is drawn around, whose side it is, whether it is round.
  function pieces(track, pose) {
    const { parents, sides, radii, head, stature } = track, size = stature;
    const place = (j) => [pose[3 * j], pose[3 * j + 1], pose[3 * j + 2]];
    const ball = (j) => [...place(j), radii[j] * size];
    const made = track.trunk.map((joints) => ({ balls: joints.map(ball), side: 0, trunk: true }));
    for (const j of track.bones) {
      const balls = [ball(parents[j]), ball(j)];
      if (track.toes.includes(j)) {
        const ankle = place(parents[j]), heel = towards(ankle, place(parents[parents[j]]), 0.03 * size);
        balls.push([...heel, 0.021 * size]);
      }
      made.push({ balls, side: sides[j] });
    }
    for (const j of track.hands) {
      const along = (by, r) => [...towards(place(j), place(parents[j]), by * size), r * size];
      made.push({ balls: [ball(j), along(0.035, 0.021), along(0.075, 0.011)], side: sides[j] });
    }
    made.push({ balls: skull(track, place), side: 0, round: true });
    return made;
  }

  function skull(track, place) {                          // with chin and nose: they say which way the face looks
    const size = track.stature, [rHip, lHip, rShoulder, lShoulder] = track.face.map(place);
    const head = place(track.head), neck = place(track.parents[track.head]);
    const across = [0, 1, 2].map((k) => lShoulder[k] - rShoulder[k] + 0.3 * (lHip[k] - rHip[k]));
    const ahead = cross(across, [0, 1, 2].map((k) => head[k] - neck[k])), length = Math.hypot(...ahead) || 1;
    const at = (up, front, r) =>
      [...towards(head, neck, up * size).map((v, k) => v + front * size * ahead[k] / length), r * size];
    return [at(0.085, 0.005, 0.053), at(0.035, 0.016, 0.037), at(0.06, 0.058, 0.009)];
  }

  function hull(points) {                                 // the outline around points, by Andrew's monotone chain
    points.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const turn = (o, a, b) => (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    const half = (along) => {
      const chain = [];
      for (const p of along) {
        while (chain.length > 1 && turn(chain.at(-2), chain.at(-1), p) <= 0) chain.pop();
        chain.push(p);
      }
      return chain.slice(0, -1);
    };
    return half(points).concat(half(points.reverse()));
  }
  function outlined(path, outline) {
    outline.forEach(([x, y], i) => i ? path.lineTo(x, y) : path.moveTo(x, y));
    path.closePath();
  }
  function around(circles) {
    return hull(circles.flatMap(([x, y, r]) => ROUND.map(([c, s]) => [x + r * c, y + r * s])));
  }
  function limb(path, [x0, y0, r0], [x1, y1, r1]) {       // two circles and their outer tangents
    const length = Math.hypot(x1 - x0, y1 - y0), way = Math.atan2(y1 - y0, x1 - x0);
    if (length <= Math.abs(r0 - r1)) {
      r0 > r1 ? path.arc(x0, y0, r0, 0, 7) : path.arc(x1, y1, r1, 0, 7);
      return;
    }
    const touch = Math.acos((r0 - r1) / length);
    path.arc(x0, y0, r0, way + touch, way - touch + 2 * Math.PI);
    path.arc(x1, y1, r1, way - touch, way + touch);
    path.closePath();
  }

  // Light across a limb as across a cylinder, over a head as over a ball.
  function skin(ink, circles, outline, { round, trunk }, tone) {
    const [x0, y0, r0] = circles[0], [x1, y1, r1] = circles[trunk ? circles.length - 1 : 1];
    const length = Math.hypot(x1 - x0, y1 - y0), thick = Math.max(r0, r1);
    if (round || length < 0.35 * thick) {
      const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2, r = thick + length / 2;
      const [x, y] = [cx + 0.5 * r * LIGHT[0], cy + 0.5 * r * LIGHT[1]];
      const ball = ink.createRadialGradient(x, y, 0.1 * r, cx, cy, 1.02 * r);
      [[0, 0.95], [0.45, 0.72], [0.8, 0.35], [1, 0.02]].forEach(([at, light]) => ball.addColorStop(at, tone(light)));
      return ball;
    }
    const n = [-(y1 - y0) / length, (x1 - x0) / length], lit = n[0] * LIGHT[0] + n[1] * LIGHT[1];
    const reach = outline ? outline.map(([x, y]) => (x - x0) * n[0] + (y - y0) * n[1]) : [-thick, thick];
    const low = Math.min(...reach), high = Math.max(...reach);
    const made = ink.createLinearGradient(x0 + low * n[0], y0 + low * n[1], x0 + high * n[0], y0 + high * n[1]);
    for (const u of STOPS) made.addColorStop((u + 1) / 2, tone(u * lit + Math.sqrt(1 - u * u) * LIGHT[2]));
    return made;
  }

  // What to paint, each with its depth; `tone` gives the colour of a side at a depth (0 to 1 of fog) in a light.
  function parts(track, ink, camera, made, pose, tone) {
    const root = camera.project(pose[0], pose[1], pose[2]), middle = root ? root[2] : camera.distance;
    return made.flatMap((piece) => {
      const seen = piece.balls.map(([x, y, z, r]) => [camera.project(x, y, z), r]);
      if (!seen.every(([p]) => p)) return [];
      const circles = seen.map(([p, r]) => [p[0], p[1], r * p[3]]);
      const depth = seen.reduce((sum, [p]) => sum + p[2], 0) / seen.length;
      const fog = Math.min(Math.max(0.06 + (depth - middle) / (2 * track.stature), 0), 0.4);
      return [{ depth, paint: () => {
        const outline = circles.length > 2 ? around(circles) : null;
        ink.beginPath();
        outline ? outlined(ink, outline) : limb(ink, ...circles);
        ink.fillStyle = skin(ink, circles, outline, piece, (light) => tone(piece.side, fog, light));
        ink.fill();
      } }];
    });
  }

  function groundPrint(path, camera, balls) {                   // what balls cover of the ground
    const points = balls.flatMap(([x, , z, r]) => COARSE.map(([c, s]) => camera.project(x + r * c, 0, z + r * s)));
    if (points.every(Boolean)) outlined(path, hull(points));
  }
  function drawShadow(ink, camera, made, colour) {
    const path = new Path2D();
    for (const { balls } of made) groundPrint(path, camera, balls);
    ink.fillStyle = colour;
    ink.fill(path);
  }
  function drawContacts(track, ink, camera, pose, frame, colour) {   // a print below each foot that stands
    const path = new Path2D();
    track.toes.forEach((toe, side) => {
      if (!track.stands(side, Math.round(frame))) return;
      const spots = [track.parents[toe], toe].map((j) => [pose[3 * j], 0, pose[3 * j + 2], 0.045 * track.stature]);
      groundPrint(path, camera, spots);
    });
    ink.fillStyle = colour;
    ink.fill(path);
  }

  kinema.figure = { pieces, parts, drawShadow, drawContacts };
})();
