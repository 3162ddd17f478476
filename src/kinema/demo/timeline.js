// Two thumbs that can't pass each other; the players show the frame that is under the thumb.
const thumbs = () => [...element.querySelectorAll("input")];
element.addEventListener("input", (event) => {
  const [start, end] = thumbs();
  if (event.target === start) start.value = Math.min(+start.value, +end.value - 1);
  else end.value = Math.max(+end.value, +start.value + 1);
  props.value = { ...props.value, start: +start.value, end: +end.value };
  const frame = document.querySelector("#demo-players iframe");
  frame?.contentWindow.postMessage({ kinemaSeek: +event.target.value / props.value.fps }, "*");
});
watch("value", () => {
  const [start, end] = thumbs();
  start.value = props.value.start;
  end.value = props.value.end;
});
