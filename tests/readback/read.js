// Read exports with three.js and check them with Khronos' validator; bundled for a page by `make readers`.
import { AnimationMixer, LoopOnce } from "three";
import { BVHLoader } from "three/addons/loaders/BVHLoader.js";
import { FBXLoader } from "three/addons/loaders/FBXLoader.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { validateBytes } from "gltf-validator";

const bytes = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));

async function load(format, content) {
  if (format === "bvh") {
    const { skeleton, clip } = new BVHLoader().parse(new TextDecoder().decode(content));
    return [skeleton.bones[0], clip];
  }
  if (format === "fbx") {
    const group = new FBXLoader().parse(content.buffer, "");
    return [group, group.animations[0]];
  }
  const gltf = await new GLTFLoader().parseAsync(content.buffer, "");
  return [gltf.scene, gltf.animations[0]];
}

// Where every bone is at every time (seconds), by its name; the first of two nodes of one name counts.
export async function positions(format, base64, times) {
  const [root, clip] = await load(format, bytes(base64));
  const mixer = new AnimationMixer(root);
  const action = mixer.clipAction(clip).setLoop(LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  return times.map((time) => {
    mixer.setTime(time);
    root.updateMatrixWorld(true);
    const found = {};
    root.traverse((node) => (found[node.name] ??= node.matrixWorld.elements.slice(12, 15)));
    return found;
  });
}

// The validator's errors and warnings.
export async function complaints(base64) {
  const { issues } = await validateBytes(bytes(base64));
  return issues.messages.filter((message) => message.severity < 2).map((message) => `${message.code} ${message.pointer}`);
}
