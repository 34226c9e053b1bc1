// Browsers refuse workers to pages that are opened as files. The theme's search then runs its script in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(script) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inside = frame.contentWindow;
      addEventListener("message", ({ source, data }) => {
        if (source === this.inside) this.dispatchEvent(new MessageEvent("message", { data }));
      });
      const load = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((loaded) => {
        const element = document.createElement("script");
        Object.assign(element, { src: url, onload: loaded });
        document.body.append(element);
      })), Promise.resolve());
      this.inside.document.open();
      this.inside.document.write(`<body><script>
        postMessage = (data) => parent.postMessage(data, "*");
        importScripts = ${load};
        <\/script><script src="${script}"><\/script></body>`);
      this.ready = new Promise((loaded) => this.inside.addEventListener("load", loaded));
      this.inside.document.close();
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
