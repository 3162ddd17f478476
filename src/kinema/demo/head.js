// The frame of the players is as high as what is in it.
addEventListener("message", ({ data, source }) => {
  const frame = document.querySelector("#demo-players iframe");
  if (frame && source === frame.contentWindow && data.kinemaHeight) frame.style.height = `${data.kinemaHeight + 2}px`;
});
