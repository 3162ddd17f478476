// Every `.kinema-player` of the page: read when it comes into view, one animation loop, one set of settings.
(() => {
  "use strict";
  const HOME = { turn: 0.6, pitch: 0.2, zoom: 1 };
  const settings = { playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, speed: 1, sync: false,
                     follow: true, trail: true };
  const shared = { time: 0, playing: settings.playing, view: { ...HOME } };
  const players = new Set(), packs = new Map();

  // A pack is a script, for a page of file:// may fetch nothing: it calls kinema.pack([motion, ...]).
  function readPack(url) {
    if (!packs.has(url)) packs.set(url, new Promise((resolve, reject) => {
      const script = document.createElement("script");
      script.kinemaResolve = resolve;
      script.onerror = () => reject(new Error(`${url} cannot be read`));
      script.src = url;
      document.head.append(script);
    }));
    return packs.get(url);
  }
  function clamp(v, low, high) { return Math.min(high, Math.max(low, v)); }

  class Player {                                          // data-motion is the motion; data-packs names it instead
    constructor(figure) {
      this.figure = figure;
      this.fps = +figure.dataset.fps;
      this.frames = +figure.dataset.frames;
      this.own = { time: 0, playing: settings.playing, view: { ...HOME } };
      this.visible = false;
      this.stage = figure.querySelector(".kinema-stage");
      this.stage.after(controls());
      this.canvas = this.stage.querySelector("canvas");
      this.slider = figure.querySelector("input");
      this.clock = figure.querySelector(".kinema-clock");
      this.slider.max = this.frames - 1;
      this.listen();
    }
    get state() { return settings.sync ? shared : this.own; }
    get duration() { return (this.frames - 1) / this.fps; }
    get frame() { return clamp(this.state.time * this.fps, 0, this.frames - 1); }

    async load() {
      if (this.loading) return;
      this.loading = true;
      const { motion, packs } = this.figure.dataset;
      const named = packs ? JSON.parse(packs) : [];       // [[url, index, label], ...]
      try {
        const found = motion ? [[JSON.parse(motion), ""]]
          : await Promise.all(named.map(async ([url, index, label]) => [(await readPack(url))[index], label]));
        this.tracks = found.map(([data, label]) => new kinema.Track(data, label));
        this.showKept();
      } catch (error) {
        this.stage.replaceChildren(Object.assign(document.createElement("p"), { textContent: error.message }));
        this.figure.classList.add("kinema-broken");
      }
    }
    showKept() {                                          // below the slider: which frames an edit kept
      const [track, other] = this.tracks;
      if (other || !track.kept.length) return;
      const stops = track.kept.flatMap(([start, end]) => {
        const [a, b] = [start, end].map((f) => `${(100 * f / this.frames).toFixed(2)}%`);
        return [`var(--kinema-made) ${a}`, `var(--kinema-kept) ${a} ${b}`, `var(--kinema-made) ${b}`];
      });
      this.slider.style.backgroundImage = `linear-gradient(90deg, ${stops.join(", ")})`;
      this.slider.classList.add("kinema-ranges");
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
        const act = { " ": () => this.toggle(), ArrowRight: () => this.step(1), ArrowLeft: () => this.step(-1) }[e.key];
        if (act) { act(); e.preventDefault(); }
      };
    }
    toggle() { this.state.playing = !this.state.playing; refreshToolbars(); }
    step(by) { this.state.playing = false; this.seek(clamp(Math.round(this.frame) + by, 0, this.frames - 1)); }
    seek(frame) { this.state.time = frame / this.fps; refreshToolbars(); }

    draw() {
      const ratio = window.devicePixelRatio || 1;
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
      if (!width || !height || !this.tracks) return;
      const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
      if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
      const { time, playing, view } = this.state, { follow, trail } = settings;
      const now = [time, playing, view.turn, view.pitch, view.zoom, follow, trail, w, h, kinema.shade()].join();
      if (now === this.drawn) return;                     // what stands still costs nothing
      this.drawn = now;
      const ink = this.canvas.getContext("2d");
      ink.setTransform(ratio, 0, 0, ratio, 0, 0);
      kinema.draw(ink, this.tracks, time, view, { ...settings, whole: !playing }, width, height);
      this.report();
    }
    report() {
      const whole = Math.round(this.frame), clock = `${(whole / this.fps).toFixed(1)} / ${this.duration.toFixed(1)} s`;
      const [track] = this.tracks, edit = this.tracks.length === 1 && track.kept.length;
      const what = edit ? (track.keeps(whole) ? "kept" : "generated") + " · " : "";
      if (document.activeElement !== this.slider || this.state.playing) this.slider.value = whole;
      if (this.clock.value !== what + clock) this.clock.value = what + clock;
      this.clock.title = `frame ${whole + 1} of ${this.frames}`;
      this.figure.classList.toggle("kinema-playing", this.state.playing);
    }
    show(visible) {                                       // what is out of view holds no pixels
      this.visible = visible;
      this.drawn = null;
      if (visible) this.load(); else this.canvas.width = this.canvas.height = 0;
    }
  }

  const template = document.createElement("template");
  template.innerHTML = "<div class='kinema-controls'><button type='button' class='kinema-play' aria-label='Play or pause'>"
    + "</button><input type='range' min='0' value='0' step='1' aria-label='Frame'>"
    + "<output class='kinema-clock' aria-live='off'></output></div>";
  function controls() { return template.content.cloneNode(true); }

  const present = () => [...players].filter((player) => player.figure.isConnected);
  const running = () => settings.sync ? shared.playing : present().some((player) => player.own.playing);
  const duration = () => Math.max(0, ...present().map((player) => player.duration));

  function refreshToolbars() {
    document.querySelectorAll(".kinema-toolbar [data-action]").forEach((control) => {
      const action = control.dataset.action;
      if (action === "play") control.textContent = running() ? "Pause all" : "Play all";
      else if (action === "speed") control.value = String(settings.speed);
      else if (action === "seek") control.parentElement.hidden = !settings.sync;
      else if (action in settings) control.setAttribute("aria-pressed", String(settings[action]));
    });
  }
  function playAll(on) {
    shared.playing = on;
    players.forEach((player) => { player.own.playing = on; });
    refreshToolbars();
  }
  function seekAll(time) {
    shared.time = time;
    players.forEach((player) => { player.own.time = Math.min(time, player.duration); });
  }
  function syncAll(on) {
    settings.sync = on;
    if (on) { seekAll(0); playAll(settings.playing); }
    refreshToolbars();
  }
  const actions = {
    play: () => playAll(!running()),
    sync: () => syncAll(!settings.sync),
    follow: () => { settings.follow = !settings.follow; },
    trail: () => { settings.trail = !settings.trail; },
    reset: () => { shared.view = { ...HOME }; players.forEach((player) => { player.own.view = { ...HOME }; }); },
  };
  const changes = {
    speed: (value) => { settings.speed = value; },
    seek: (value) => { playAll(false); seekAll(value * duration()); },
  };

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) entry.target.kinema.show(entry.isIntersecting);
  }, { rootMargin: "80px" });

  function scan() {                                       // take in the players that were added
    document.querySelectorAll(".kinema-player:not(.kinema-broken)").forEach((figure) => {
      if (figure.kinema) return;
      figure.kinema = new Player(figure);
      players.add(figure.kinema);
      seen.observe(figure);
    });
    document.querySelectorAll(".kinema-toolbar").forEach((bar) => {
      bar.onclick = (e) => {
        const action = actions[e.target.dataset.action];
        if (action) { action(); refreshToolbars(); }
      };
      bar.oninput = (e) => { changes[e.target.dataset.action]?.(+e.target.value); refreshToolbars(); };
    });
    document.querySelectorAll(".kinema-viewer[data-sync]").forEach((viewer) => {
      delete viewer.dataset.sync;
      syncAll(true);
    });
    refreshToolbars();
  }
  function forget(figure) {                               // a player that is taken off the page
    if (!figure.kinema) return;
    seen.unobserve(figure);
    players.delete(figure.kinema);
  }

  let before = null;
  function tick(now) {
    const elapsed = Math.min(0.1, before === null ? 0 : (now - before) / 1000) * settings.speed;
    before = now;
    const advance = (state, end) => {                     // rest half a second on the last frame, then begin again
      if (state.playing) state.time = state.time + elapsed > end + 0.5 ? 0 : state.time + elapsed;
    };
    const shown = present().filter((player) => player.visible);
    if (settings.sync) {
      const end = duration();
      advance(shared, end);
      document.querySelectorAll(".kinema-toolbar [data-action=seek]").forEach((slider) => {
        if (shared.playing || document.activeElement !== slider) slider.value = Math.min(1, shared.time / (end || 1));
      });
    } else shown.forEach((player) => advance(player.own, player.duration));
    shown.forEach((player) => player.draw());
    requestAnimationFrame(tick);
  }

  const pack = (motions) => document.currentScript.kinemaResolve(motions);
  Object.assign(kinema, { scan, forget, pack, playAll, seekAll, syncAll, players, settings, shared });
  requestAnimationFrame(tick);
})();
