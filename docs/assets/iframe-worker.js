/* Pages opened as files may start no worker, so that the search would find nothing. Its script runs
   in a hidden frame instead, to which messages are passed, and from which they come back. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const source = new URL(url, location.href).href.replaceAll('"', "%22")
      const script = (attributes, text) => `<script${attributes}>${text}</` + "script>"
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      this.frame.answer = data => this.dispatchEvent(new MessageEvent("message", { data }))
      this.loaded = new Promise(resolve => (this.frame.begin = resolve))
      document.documentElement.append(this.frame)
      const inside = this.frame.contentDocument
      inside.open()
      inside.write(
        script("", "postMessage = data => frameElement.answer(data)") +
          script(` src="${source}"`, "") +
          script("", "frameElement.begin()")
      )
      inside.close()
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
