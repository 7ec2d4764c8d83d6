// Device and settings in the address, after the #. A browser does not send that part to a server.
import { BOARD } from "./connect.js";
import { TUNINGS, WALL } from "./settings.js";

const coded = {
  async write(text) {
    const stream = new Blob([text]).stream().pipeThrough(new CompressionStream("deflate-raw"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")).replace(/\+/g, "-").replace(/\//g, "_").replace(/=/g, "");
  },
  async read(text) {
    const bytes = Uint8Array.from(atob(text.replace(/-/g, "+").replace(/_/g, "/")), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
    let [text_, size] = ["", 0];
    const decoder = new TextDecoder("utf-8", { fatal: true });
    for (;;) {
      const { done, value } = await stream.read();
      if (done) return text_ + decoder.decode();
      size += value.length;
      if (size > 1 << 20) throw new Error("its scene is larger than a scene may be, allowed 1 MiB");
      text_ += decoder.decode(value, { stream: true });
    }
  },
};

const KEYS = [...TUNINGS, ...WALL];
const isName = (text) => /^[a-z0-9-]{1,40}$/.test(text);

// The fragment of an address.
export async function address(scene, core, settings) {
  const words = new URLSearchParams({ scene: scene.scene });
  if (scene.text !== undefined) words.set("text", await coded.write(scene.text));
  if (core) words.set("runs", "core");
  for (const key of ["estimator", ...KEYS]) if (settings[key] !== undefined) words.set(key, settings[key]);
  return `#${words}`;
}

// Reads the device and settings of an address; throws what is not valid.
export async function read(hash) {
  const words = new URLSearchParams(hash.slice(1));
  const settings = {};
  for (const key of KEYS) {
    if (!words.has(key)) continue;
    const value = words.get(key);
    if (!value || !Number.isFinite(+value)) throw new Error(`${key} is ${value.slice(0, 40)}, allowed a number`);
    settings[key] = +value;
  }
  const estimator = words.get("estimator");
  if (estimator !== null) {
    if (!isName(estimator)) throw new Error(`estimator is ${estimator.slice(0, 40)}, allowed the name of one`);
    settings.estimator = estimator;
  }
  const scene = { scene: (words.get("scene") ?? BOARD).slice(0, 200), core: words.get("runs") === "core" };
  if (words.has("text")) {
    try {
      scene.text = await coded.read(words.get("text"));
    } catch (error) {
      throw new Error(`text is no scene of such a link: ${error.message}`);
    }
  }
  return { scene, settings };
}
