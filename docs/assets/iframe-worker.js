/* Pages opened as files may start no worker, so that the search would find nothing. Its script runs
   in a hidden frame instead, to which messages are passed, and from which they come back. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      this.frame.answer = data => this.dispatchEvent(new MessageEvent("message", { data }))
      const source = new URL(url, location.href).href.replaceAll('"', "%22")
      this.frame.srcdoc =
        "<script>postMessage = data => frameElement.answer(data)</" + "script>" +
        `<script src="${source}"></` + "script>"
      this.loaded = new Promise(resolve => (this.frame.onload = resolve))
      document.documentElement.append(this.frame)
    }
    postMessage(data) {
      this.loaded.then(() => {
        const inside = this.frame.contentWindow
        inside.dispatchEvent(new inside.MessageEvent("message", { data }))
      })
    }
    terminate() {
      this.frame.remove()
    }
  }
}
