// Starts the Rerun viewer with the recording at the address `?url=`. `?renderer=webgl|webgpu` selects how it draws.
"use strict";

const query = new URLSearchParams(location.search);
const recordings = query.getAll("url");

function say(text) {
  document.getElementById("message").textContent = text;
}

// The viewer would report its use to its makers. The server's content security policy forbids that; here it is not even
// tried. Only this page and its data are fetched.
const origins = [location.origin, ...recordings.map((url) => new URL(url.replace(/^rerun\+/, "")).origin)];
const fetchAnything = window.fetch;
window.fetch = (request, options) => {
  const url = new URL(request.url ?? request, location);
  const isOwn = origins.includes(url.origin) || ["data:", "blob:"].includes(url.protocol);
  return isOwn ? fetchAnything(request, options) : Promise.reject(new TypeError(`${url.origin} is not on this machine`));
};

// Labels are too pale to read in the viewer's light theme. Its option `theme` has no effect, but it asks for the system's.
const systemMedia = window.matchMedia.bind(window);
const always = { "(prefers-color-scheme: dark)": "all", "(prefers-color-scheme: light)": "not all" };
window.matchMedia = (query) => systemMedia(always[query] ?? query);

async function start() {
  const response = await fetch("re_viewer_bg.wasm");
  const size = Number(response.headers.get("content-length"));
  let loaded = 0;
  const count = new TransformStream({
    transform(part, to) {
      loaded += part.byteLength;
      say(`Loading the viewer: ${Math.floor((100 * loaded) / size)} %`);
      to.enqueue(part);
    },
  });
  await wasm_bindgen(new Response(response.body.pipeThrough(count), { headers: response.headers }));
  const handle = new wasm_bindgen.WebHandle({
    url: recordings,
    render_backend: query.get("renderer"),
    hide_welcome_screen: true, // it lists examples from the web
    persist: true,
  });
  setInterval(() => handle.has_panicked() && say(`The viewer has crashed.\n${handle.panic_message()}`), 1000);
  await handle.start(document.getElementById("viewer"));
  say("");
}

start().catch((error) => say(`The viewer does not start: ${error}\nTry &renderer=webgl or &renderer=webgpu.`));
