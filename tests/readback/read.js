// Read exports with three.js and check them with Khronos' validator; bundled for a page by `make readers`.
import { AnimationMixer, LoopOnce } from "three";
import { BVHLoader } from "three/addons/loaders/BVHLoader.js";
import { FBXLoader } from "three/addons/loaders/FBXLoader.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { createVRMAnimationClip, VRMAnimationLoaderPlugin } from "@pixiv/three-vrm-animation";
import { VRMCore, VRMHumanoid } from "@pixiv/three-vrm-core";
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

// Where every node is at every time (seconds), by its name; the first of two of one name counts.
function play(root, clip, times, update = () => {}) {
  const mixer = new AnimationMixer(root);
  const action = mixer.clipAction(clip).setLoop(LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  return times.map((time) => {
    mixer.setTime(time);
    update();
    root.updateMatrixWorld(true);
    const found = {};
    root.traverse((node) => (found[node.name] ??= node.matrixWorld.elements.slice(12, 15)));
    return found;
  });
}

export async function positions(format, base64, times) {
  const [root, clip] = await load(format, bytes(base64));
  return play(root, clip, times);
}

// A VRM model moved by a VRMA: the model is the file's own skeleton at rest.
export async function drive(base64, times) {
  const loader = new GLTFLoader().register((parser) => new VRMAnimationLoaderPlugin(parser));
  const { userData, parser } = await loader.parseAsync(bytes(base64).buffer, "");
  const { scene } = await new GLTFLoader().parseAsync(bytes(base64).buffer, "");
  const { nodes, extensions } = parser.json;
  const named = Object.entries(extensions.VRMC_vrm_animation.humanoid.humanBones);
  const bones = named.map(([bone, { node }]) => [bone, { node: scene.getObjectByName(nodes[node].name) }]);
  const humanoid = new VRMHumanoid(Object.fromEntries(bones));
  scene.add(humanoid.normalizedHumanBonesRoot);
  const vrm = new VRMCore({ scene, humanoid, meta: { metaVersion: "1" } });
  return play(scene, createVRMAnimationClip(userData.vrmAnimations[0], vrm), times, () => vrm.update(0));
}

// The validator's errors and warnings.
export async function complaints(base64) {
  const { issues } = await validateBytes(bytes(base64));
  return issues.messages.filter((message) => message.severity < 2).map((message) => `${message.code} ${message.pointer}`);
}
