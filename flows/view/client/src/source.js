// Where data comes from: the server that sent the page, or the page itself when it is a file.

/** Asks the server. What is named by its content is kept by the browser. */
class Server {
  embedded = false;

  async json(path) {
    const answer = await fetch(`api/${path}`);
    const value = await answer.json().catch(() => ({ error: `the server answered ${answer.status}` }));
    if (!answer.ok) throw new Error(value.error ?? `the server answered ${answer.status}`);
    return value;
  }

  async bytes(name) {
    const answer = await fetch(`blobs/${encodeURIComponent(name)}`);
    if (!answer.ok) throw new Error(`${name} is not there`);
    return answer.arrayBuffer();
  }

  async picture(path) {
    const answer = await fetch(`api/${path}`);
    if (!answer.ok) throw new Error((await answer.json()).error);
    return answer.blob();
  }
}

/** Takes everything out of the page: answers as JSON, bytes as compressed text, each in an element of its own. */
class Embedded {
  embedded = true;

  #element(id) {
    const node = document.getElementById(id);
    if (node === null) throw new Error("is not in this file");
    return node;
  }

  async json(path) {
    return JSON.parse(this.#element(`api/${path}`).textContent);
  }

  async bytes(name) {
    const packed = Uint8Array.from(atob(this.#element(`blobs/${name}`).textContent), (letter) => letter.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  }

  async picture() {
    throw new Error("frames are not in this file: they stay where the scan is");
  }
}

export const source = document.getElementById("api/scenes") ? new Embedded() : new Server();

/** The path of a scene in the API. */
export const pathOf = (scene) => `scenes/${scene.split("/").map(encodeURIComponent).join("/")}`;
