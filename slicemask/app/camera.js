// Moves the camera on a tile by pointer, touch and keys, and asks the server for what it sees.
//
// The camera itself moves here, at once. Two questions are under way at most, so that one is computed
// while the other's answer is drawn, and nothing queues up however fast the pointer moves.

const STEP = 0.01, STEP_DEG = 1, FINER = 0.1, COARSER = 10
const AT_ONCE = 2
const PATIENCE_MS = 2000 // after this, an answer is taken for lost

function install(view) {
  const el = view.el
  let asked = 0, answered = 0, sentAt = 0, wanted = false, pointer = [null, null], drag = null

  const clip = (value) => Math.min(1, Math.max(0, value))
  const azimuth = (du, dv) => (Math.atan2(du, -dv) * 180 / Math.PI + 360) % 360

  function ask() { wanted = true; send() }

  function send() {
    const now = performance.now()
    if (!wanted || (asked - answered >= AT_ONCE && now - sentAt < PATIENCE_MS)) return
    wanted = false
    asked += 1
    sentAt = now
    const { x, y, heading } = camera.data
    request.data = {
      u: [x[0]], v: [y[0]], heading: [heading[0]],
      pointer_u: [pointer[0]], pointer_v: [pointer[1]], number: [asked],
    }
  }

  function place(u, v, heading) {
    const { data } = camera
    data.x[0] = clip(u)
    data.y[0] = clip(v)
    data.heading[0] = ((heading % 360) + 360) % 360
    const radians = data.heading[0] * Math.PI / 180
    data.tip_x[0] = data.x[0] + reach * Math.sin(radians)
    data.tip_y[0] = data.y[0] - reach * Math.cos(radians)
    camera.change.emit()
    ask()
  }

  function at(event) {
    const box = el.getBoundingClientRect()
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height, box.width]
  }

  function drawStroke(u, v) {
    const { data } = stroke
    data.x1[0] = u
    data.y1[0] = v
    data.radius[0] = mode.text === "circle" ? Math.hypot(u - data.x0[0], v - data.y0[0]) : 0
    stroke.change.emit()
  }

  function follow(event) {
    const [u, v] = at(event)
    const { x, y, heading } = camera.data
    if (drag === "turn") place(x[0], y[0], azimuth(u - x[0], v - y[0]))
    else if (drag === "move") place(u, v, heading[0])
    else if (drag === "stroke") drawStroke(clip(u), clip(v))
  }

  el.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return
    const [u, v, width] = at(event)
    const { tip_x, tip_y } = camera.data
    const grip = (event.pointerType === "touch" ? 28 : 16) / width
    if (mode.text !== "camera") {
      drag = "stroke"
      stroke.data.x0[0] = clip(u)
      stroke.data.y0[0] = clip(v)
    } else if (Math.hypot(u - tip_x[0], v - tip_y[0]) < grip) drag = "turn"
    else drag = "move"
    pointer = [null, null]
    el.setPointerCapture(event.pointerId)
    el.focus({ preventScroll: true })
    event.preventDefault()
    follow(event)
  })
  el.addEventListener("pointermove", (event) => {
    if (drag) return follow(event)
    const [u, v] = at(event)
    pointer = u >= 0 && u < 1 && v >= 0 && v < 1 ? [u, v] : [null, null]
    ask()
  })
  const release = () => {
    if (drag === "stroke") stroke.data = { ...stroke.data, number: [stroke.data.number[0] + 1] }
    drag = null
  }
  el.addEventListener("pointerup", release)
  el.addEventListener("pointercancel", release)
  el.addEventListener("pointerleave", () => {
    if (drag) return
    pointer = [null, null]
    ask()
  })
  el.addEventListener("wheel", (event) => {
    if (!event.shiftKey) return // the page scrolls
    event.preventDefault()
    const { x, y, heading } = camera.data
    place(x[0], y[0], heading[0] + Math.sign(event.deltaY || event.deltaX) * STEP_DEG * 3)
  }, { passive: false })

  const MOVES = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, -1, 0],
    ArrowDown: [0, 1, 0], q: [0, 0, -1], e: [0, 0, 1] }
  el.addEventListener("keydown", (event) => {
    const move = MOVES[event.key.length === 1 ? event.key.toLowerCase() : event.key]
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    const step = STEP * (event.shiftKey ? FINER : 1)
    const turn = STEP_DEG * (event.shiftKey ? COARSER : 1)
    const { x, y, heading } = camera.data
    place(x[0] + move[0] * step, y[0] + move[1] * step, heading[0] + move[2] * turn)
  })

  reply.properties.data.change.connect(() => {
    answered = reply.data.number[0]
    el.dataset.answered = String(answered)
    send()
  })

  el.tabIndex = 0
  el.style.touchAction = "none"
  el.setAttribute("role", "application")
  el.setAttribute("aria-label", label)
  // One stop of the Tab key, not two.
  for (const inner of el.shadowRoot.querySelectorAll("*")) {
    const events = inner.shadowRoot?.querySelector(".bk-events")
    if (events) events.tabIndex = -1
  }
  el.dataset.answered = "0"
  el.dataset.ready = "true"
}

function find() {
  const view = Bokeh.index.find_one(plot)
  if (view?.el?.isConnected) install(view)
  else setTimeout(find, 50)
}
find()
