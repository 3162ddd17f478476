// One motion: its joints, decoded, where it is at a time, and how its body is painted.
(() => {
  "use strict";

  function decode(data) {                                 // 16-bit integers in base64, per-axis centre, one scale
    const bytes = Uint8Array.from(atob(data.joints), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer), out = new Float32Array(bytes.length / 2);
    for (let i = 0; i < out.length; i++) out[i] = view.getInt16(2 * i, true) * data.scale + data.centre[i % 3];
    return out;
  }

  class Track {
    constructor(data, label) {
      if (!data.trunk) throw new Error("Packed by an older version: write this report again.");
      Object.assign(this, { parents: data.parents, sides: data.sides, head: data.head, stature: data.stature,
                            fps: data.fps, kept: data.kept, face: data.face, radii: data.radii, bones: data.bones,
                            trunk: data.trunk, hands: data.hands, toes: data.toes, standing: data.standing, label });
      this.joints = decode(data);
      this.frames = this.joints.length / this.parents.length / 3;
      this.facing = this.facingAt(0, data.face);
      this.path = this.smoothPath();
    }
    at(frame, joint, axis) { return this.joints[(frame * this.parents.length + joint) * 3 + axis]; }
    frame(time) { return Math.min(Math.max(time * this.fps, 0), this.frames - 1); }   // a short one holds its end
    stands(foot, frame) { return this.standing[foot].some(([start, end]) => frame >= start && frame < end); }
    keeps(frame) { return this.kept.some(([start, end]) => frame >= start && frame < end); }
    centre(time) { return this.path[Math.round(this.frame(time))]; }

    facingAt(frame, [rHip, lHip, rShoulder, lShoulder]) {
      const across = [0, 2].map((k) => this.at(frame, lHip, k) - this.at(frame, rHip, k)
                                     + this.at(frame, lShoulder, k) - this.at(frame, rShoulder, k));
      return Math.atan2(-across[1], across[0]);           // the figure's left is +X when it faces +Z
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
    pose(frame) {
      const low = Math.floor(frame), high = Math.min(low + 1, this.frames - 1), t = frame - low;
      const width = this.parents.length * 3, out = new Float32Array(width);
      for (let i = 0; i < width; i++)
        out[i] = this.joints[low * width + i] * (1 - t) + this.joints[high * width + i] * t;
      return out;
    }
    ends() { return [0, ...this.kept.flat().filter((f) => f > 0 && f < this.frames), this.frames - 1]; }

    drawTrail(ink, camera, frame, colourOf) {             // solid where it has been, dotted where it will go
      const now = Math.round(frame), ends = [...this.ends(), now].sort((a, b) => a - b);
      ink.lineWidth = 2;
      for (let i = 0; i + 1 < ends.length; i++) {
        const ahead = ends[i] >= now;
        ink.setLineDash(ahead ? [2, 5] : []);
        ink.strokeStyle = colourOf(ends[i], ahead ? 0.55 : 0.85);
        ink.beginPath();
        let pen = false;
        for (let t = ends[i]; t <= ends[i + 1]; t++) {
          const p = camera.project(this.at(t, 0, 0), 0, this.at(t, 0, 2));
          if (p) pen ? ink.lineTo(p[0], p[1]) : ink.moveTo(p[0], p[1]);
          pen = Boolean(p);
        }
        ink.stroke();
      }
      ink.setLineDash([]);
    }
  }

  kinema.Track = Track;
})();
