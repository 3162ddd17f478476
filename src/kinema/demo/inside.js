// In the frame of the players: all on one clock; the page around them says when, and is told how high they are.
kinema.syncAll(true);
addEventListener("message", ({ data }) => {
  if (typeof data.kinemaSeek !== "number") return;
  kinema.playAll(false);
  kinema.seekAll(data.kinemaSeek);
});
new ResizeObserver(() => parent.postMessage({ kinemaHeight: document.documentElement.offsetHeight }, "*"))
  .observe(document.documentElement);
