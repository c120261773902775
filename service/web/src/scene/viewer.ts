/** Surfaces in 3-D: several panes in one canvas, all seen by one camera. */

import {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, Group, LinearFilter, Mesh as ThreeMesh, MeshBasicMaterial,
  PerspectiveCamera, Quaternion, RGBAFormat, Scene, ShaderMaterial, SphereGeometry, Texture, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

import { draftFaces, draftScale, isSlow } from "./draft";
import { at, FIRST_DIRECTION, normals, pick, radius, type Point } from "./geometry";
import { SEQUENTIAL, type Map } from "./colours";

/** One surface in a pane. */
export interface Content {
  positions: Float32Array;
  faces: Uint32Array;
  /** Where each vertex is when the surface is bent into its signature. */
  form?: Float32Array;
  /** Share of the way to the form at first. */
  bend?: number;
  uv?: Float32Array;
}

export type Colouring =
  | { kind: "plain" }
  | { kind: "field"; values: Float32Array; low: number; high: number; map: Map; contours: number; limit?: number }
  | { kind: "colours"; rgb: Float32Array }
  | { kind: "texture"; image: TexImageSource };

const VERTEX = /* glsl */ `
  attribute vec3 form;
  attribute vec3 formNormal;
  attribute float value;
  attribute vec3 rgb;
  uniform float bend;
  varying vec3 vNormal;
  varying vec3 vPlace;
  varying float vValue;
  varying vec3 vRgb;
  varying vec2 vUv;
  void main() {
    vec4 place = modelViewMatrix * vec4(mix(position, form, bend), 1.0);
    vNormal = normalMatrix * mix(normal, formNormal, bend);
    vPlace = place.xyz;
    vValue = value;
    vRgb = rgb;
    vUv = uv;
    gl_Position = projectionMatrix * place;
  }
`;

const FRAGMENT = /* glsl */ `
  uniform int kind;
  uniform vec3 plain;
  uniform sampler2D map;
  uniform float low;
  uniform float high;
  uniform float contours;
  uniform float limit;
  varying vec3 vNormal;
  varying vec3 vPlace;
  varying float vValue;
  varying vec3 vRgb;
  varying vec2 vUv;
  void main() {
    vec3 colour = plain;
    if (kind == 1) {
      bool known = vValue == vValue && vValue < 3.0e38;
      float share = clamp((vValue - low) / max(high - low, 1e-30), 0.0, 1.0);
      if (known) colour = texture2D(map, vec2(share * 0.996 + 0.002, 0.5)).rgb;
      if (known && contours > 0.0) {
        float step = share * contours;
        float width = fwidth(step);
        float line = abs(fract(step - 0.5) - 0.5) / max(width, 1e-6);
        colour = mix(colour * 0.35, colour, smoothstep(0.6, 1.5, line + (width > 0.8 ? 2.0 : 0.0)));
      }
      if (known && limit >= 0.0) {
        float edge = (vValue - limit) / max(fwidth(vValue), 1e-30);
        colour = mix(colour, plain, smoothstep(-0.5, 0.5, edge) * 0.85);
        colour = mix(vec3(0.9, 0.25, 0.1), colour, smoothstep(0.8, 2.2, abs(edge)));
      }
    } else if (kind == 2) {
      colour = vRgb;
    } else if (kind == 3) {
      colour = texture2D(map, vUv).rgb;
    }
    vec3 n = normalize(vNormal);
    vec3 toEye = normalize(-vPlace);
    if (dot(n, toEye) < 0.0) n = -n;
    float key = max(dot(n, normalize(vec3(0.45, 0.65, 0.75))), 0.0);
    float fill = max(dot(n, normalize(vec3(-0.7, 0.1, 0.5))), 0.0);
    float sky = 0.5 + 0.5 * n.y;
    float rim = pow(1.0 - max(dot(n, toEye), 0.0), 3.0);
    vec3 lit = colour * (0.30 + 0.16 * sky + 0.52 * key + 0.14 * fill) + vec3(0.10) * rim;
    gl_FragColor = vec4(pow(clamp(lit, 0.0, 1.0), vec3(1.0 / 1.08)), 1.0);
  }
`;

const UPRIGHT: Record<string, Point> = {
  y: [0, 1, 0], z: [0, 0, 1], x: [1, 0, 0], "-y": [0, -1, 0], "-z": [0, 0, -1], "-x": [-1, 0, 0],
};
const KINDS = { plain: 0, field: 1, colours: 2, texture: 3 } as const;

const ANGLE = 30; // degrees that the camera sees
const FRONT = new Vector3(...FIRST_DIRECTION);
const REST = 250; // milliseconds without a movement after which a whole frame follows drafts

interface Pane {
  content: Content;
  whole: BufferAttribute;
  /** The faces of drafts, made when first needed. */
  draft: BufferAttribute | null;
  scene: Scene;
  turned: Group;
  mesh: ThreeMesh<BufferGeometry, ShaderMaterial>;
  marks: Group;
}

export class Viewer {
  readonly canvas: HTMLCanvasElement;
  /** Called with the vertex that was clicked, and its pane. */
  onpick: ((vertex: number, pane: number) => void) | null = null;
  /** Called with the vertex below the pointer, and its pane, if frames are fast enough to follow it. */
  onhover: ((vertex: number, pane: number) => void) | null = null;
  /** Number of frames drawn, for measurements. */
  frames = 0;
  private readonly renderer: WebGLRenderer;
  private readonly camera = new PerspectiveCamera(ANGLE, 1, 0.01, 100);
  private readonly controls: OrbitControls;
  private readonly panes: Pane[];
  private readonly size: number;
  private readonly observer: ResizeObserver;
  private waiting = false;
  /** Milliseconds of a whole frame; 0 until measured. */
  private cost = 0;
  private wholeFrames = 0;
  private moved = -Infinity;
  private resting = 0;
  private pressed: { x: number; y: number } | null = null;
  private stacked = false;
  private following = false;

  /** Throws if WebGL is missing. */
  constructor(contents: Content[], up: string, label: string) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.canvas = this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", label);
    this.size = Math.max(...contents.map(({ positions, form }) => Math.max(radius(positions), form ? radius(form) : 0))) || 1;
    this.panes = contents.map((content) => this.pane(content));
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => this.drawMoving());
    this.canvas.addEventListener("pointerdown", (event) => (this.pressed = { x: event.clientX, y: event.clientY }));
    this.canvas.addEventListener("pointerup", (event) => this.released(event));
    this.canvas.addEventListener("pointermove", (event) => this.hovered(event));
    this.canvas.addEventListener("keydown", (event) => this.turnByKey(event));
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.canvas);
    this.setUp(up);
    this.reset();
  }

  /** Turn all surfaces so that an axis of the file points upwards. */
  setUp(axis: string): void {
    const turn = new Quaternion().setFromUnitVectors(new Vector3(...(UPRIGHT[axis] ?? UPRIGHT["z"]!)), new Vector3(0, 1, 0));
    for (const { turned } of this.panes) turned.quaternion.copy(turn);
    this.draw();
  }

  /** Return to the first view. */
  reset(): void {
    const away = 1.06 * this.fitted();
    this.camera.position.copy(FRONT).multiplyScalar(away);
    this.camera.near = away / 100;
    this.camera.far = away * 10;
    this.controls.target.set(0, 0, 0);
    this.controls.update();
    this.draw();
  }

  /** Bend a pane: 0 is the surface, 1 its signature. */
  bend(pane: number, share: number): void {
    this.panes[pane]!.mesh.material.uniforms["bend"]!.value = share;
    this.panes[pane]!.content.bend = share;
    this.panes[pane]!.marks.visible = share < 0.02 || share === 1;
    this.drawMoving();
  }

  /** Colour a pane, or all panes alike. */
  colour(colouring: Colouring, pane?: number): void {
    for (const { mesh } of pane === undefined ? this.panes : [this.panes[pane]!]) {
      const uniforms = mesh.material.uniforms;
      uniforms["kind"]!.value = KINDS[colouring.kind];
      if (colouring.kind === "field") {
        mesh.geometry.setAttribute("value", new BufferAttribute(colouring.values, 1));
        uniforms["low"]!.value = colouring.low;
        uniforms["high"]!.value = colouring.high;
        uniforms["contours"]!.value = colouring.contours;
        uniforms["limit"]!.value = colouring.limit ?? -1;
        uniforms["map"]!.value = gradient(colouring.map);
      } else if (colouring.kind === "colours") {
        mesh.geometry.setAttribute("rgb", new BufferAttribute(colouring.rgb, 3));
      } else if (colouring.kind === "texture") {
        const texture = new Texture(colouring.image as HTMLCanvasElement);
        texture.minFilter = LinearFilter;
        texture.needsUpdate = true;
        uniforms["map"]!.value = texture;
      }
    }
    this.draw();
  }

  /** Mark vertices or other points, and draw a line, in a pane. */
  mark(pane: number, places: (number | Point)[], line: Point[]): void {
    const { content, marks } = this.panes[pane]!;
    for (const mark of [...marks.children]) {
      marks.remove(mark);
      (mark as ThreeMesh).geometry.dispose();
    }
    const drawn = content.bend === 1 && content.form ? content.form : content.positions;
    places.forEach((place, number) => {
      const ball = new ThreeMesh(
        new SphereGeometry(0.02 * this.size, 20, 14),
        new MeshBasicMaterial({ color: number ? 0x2f6fde : 0xe0442b }),
      );
      ball.position.set(...(typeof place === "number" ? at(drawn, place) : place));
      marks.add(ball);
    });
    if (line.length > 1) {
      const tube = new ThreeMesh(tubeAlong(line, 0.011 * this.size), new MeshBasicMaterial({ color: 0xf2b01e }));
      marks.add(tube);
    }
    this.draw();
  }

  dispose(): void {
    clearTimeout(this.resting);
    this.observer.disconnect();
    this.controls.dispose();
    for (const { mesh } of this.panes) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.canvas.remove();
  }

  /** Draw in the next frame. */
  draw(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.render();
    });
  }

  /** Turn the camera a little, as a drag does; measurements of frames call it. */
  spin(): void {
    this.camera.position.applyAxisAngle(new Vector3(0, 1, 0), 0.02);
    this.controls.update();
  }

  /** Wait until everything is drawn; `finish()` returns before. */
  settle(): void {
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  /** Draw in the next frame: a draft if whole frames are slow, and a whole frame once the movement ends. */
  private drawMoving(): void {
    this.moved = performance.now();
    clearTimeout(this.resting);
    if (isSlow(this.cost)) this.resting = window.setTimeout(() => this.rest(), REST);
    this.draw();
  }

  private rest(): void {
    this.moved = -Infinity; // a timer may be early by less than its resolution
    this.draw();
  }

  private pane(content: Content): Pane {
    const geometry = new BufferGeometry();
    const count = content.positions.length / 3;
    geometry.setAttribute("position", new BufferAttribute(content.positions, 3));
    geometry.setAttribute("normal", new BufferAttribute(normals(content.positions, content.faces), 3));
    geometry.setAttribute("form", new BufferAttribute(content.form ?? content.positions, 3));
    const bent = content.form ? normals(content.form, content.faces) : geometry.getAttribute("normal").array;
    if (content.form) faceAlike(geometry.getAttribute("normal").array as Float32Array, bent as Float32Array);
    geometry.setAttribute("formNormal", new BufferAttribute(bent as Float32Array, 3));
    geometry.setAttribute("value", new BufferAttribute(new Float32Array(count), 1));
    geometry.setAttribute("rgb", new BufferAttribute(new Float32Array(3 * count), 3));
    geometry.setAttribute("uv", new BufferAttribute(content.uv ?? new Float32Array(2 * count), 2));
    const whole = new BufferAttribute(content.faces, 1);
    geometry.setIndex(whole);
    const material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: DoubleSide,
      uniforms: {
        bend: { value: content.bend ?? 0 },
        kind: { value: 0 },
        plain: { value: new Vector3(0.62, 0.69, 0.8) },
        map: { value: gradient(SEQUENTIAL) },
        low: { value: 0 },
        high: { value: 1 },
        contours: { value: 0 },
        limit: { value: -1 },
      },
    });
    const scene = new Scene();
    const turned = new Group();
    const marks = new Group();
    const mesh = new ThreeMesh(geometry, material);
    mesh.frustumCulled = false;
    turned.add(mesh, marks);
    scene.add(turned);
    return { content, whole, draft: null, scene, turned, mesh, marks };
  }

  /** Distance of the camera in its first direction at which every vertex is in the picture. */
  private fitted(): number {
    const right = new Vector3(0, 1, 0).cross(FRONT).normalize();
    const up = FRONT.clone().cross(right);
    const slope = Math.tan((ANGLE * Math.PI) / 360);
    const place = new Vector3();
    let most = 0;
    for (const { content, turned } of this.panes) {
      for (const points of [content.bend === 1 ? [] : content.positions, content.form ?? []]) {
        for (let i = 0; i < points.length; i += 3) {
          place.set(points[i]!, points[i + 1]!, points[i + 2]!).applyQuaternion(turned.quaternion);
          const wide = Math.max(Math.abs(place.dot(right)), Math.abs(place.dot(up)));
          most = Math.max(most, wide / slope + place.dot(FRONT));
        }
      }
    }
    return most || 1;
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.stacked = width < height;
    this.wholeFrames = 0;
    this.draw();
  }

  private rectangle(pane: number): { x: number; y: number; width: number; height: number } {
    const { clientWidth, clientHeight } = this.canvas;
    const count = this.panes.length;
    if (this.stacked) {
      const height = clientHeight / count;
      return { x: 0, y: pane * height, width: clientWidth, height };
    }
    const width = clientWidth / count;
    return { x: pane * width, y: 0, width, height: clientHeight };
  }

  private render(): void {
    const height = this.canvas.clientHeight;
    if (!height) return;
    const isDraft = isSlow(this.cost) && performance.now() - this.moved < REST;
    this.setDetail(isDraft);
    const begin = performance.now();
    this.renderer.setScissorTest(true);
    this.panes.forEach(({ scene }, number) => {
      const box = this.rectangle(number);
      const bottom = height - box.y - box.height;
      this.renderer.setViewport(box.x, bottom, box.width, box.height);
      this.renderer.setScissor(box.x, bottom, box.width, box.height);
      this.frame(box.width / box.height);
      this.renderer.render(scene, this.camera);
    });
    this.frames++;
    if (!isDraft && ++this.wholeFrames === 2) { // the first frame of a size also compiles and allocates
      this.settle();
      this.cost = performance.now() - begin;
    }
  }

  /** Choose the pixels and faces of the next frame. */
  private setDetail(isDraft: boolean): void {
    const ratio = Math.min(devicePixelRatio, 2) * (isDraft ? draftScale(this.cost) : 1);
    if (ratio !== this.renderer.getPixelRatio()) this.renderer.setPixelRatio(ratio);
    for (const pane of this.panes) {
      const { positions, form, faces } = pane.content;
      if (isDraft) pane.draft ??= new BufferAttribute(draftFaces(positions, form, faces), 1);
      const index = isDraft ? pane.draft! : pane.whole;
      if (pane.mesh.geometry.index !== index) pane.mesh.geometry.setIndex(index);
    }
  }

  /** Fit the camera to a pane: a narrow one needs a wider angle. */
  private frame(aspect: number): void {
    this.camera.aspect = aspect;
    const angle = (ANGLE * Math.PI) / 360;
    this.camera.fov = aspect >= 1 ? ANGLE : (2 * Math.atan(Math.tan(angle) / aspect) * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
  }

  private released(event: PointerEvent): void {
    const { pressed } = this;
    this.pressed = null;
    if (!pressed || Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > 4 || !this.onpick) return;
    this.below(event, this.onpick);
  }

  private hovered(event: PointerEvent): void {
    if (!this.onhover || event.buttons || event.pointerType === "touch" || this.following || isSlow(this.cost)) return;
    this.following = true;
    requestAnimationFrame(() => {
      this.following = false;
      if (this.onhover) this.below(event, this.onhover);
    });
  }

  /** Call with the vertex below the pointer, and its pane, if there is one. */
  private below(event: PointerEvent, call: (vertex: number, pane: number) => void): void {
    const bounds = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - bounds.left, event.clientY - bounds.top];
    for (let number = 0; number < this.panes.length; number++) {
      const box = this.rectangle(number);
      if (x < box.x || y < box.y || x >= box.x + box.width || y >= box.y + box.height) continue;
      this.frame(box.width / box.height);
      const ahead = new Vector3((2 * (x - box.x)) / box.width - 1, 1 - (2 * (y - box.y)) / box.height, 0.5);
      const { content, turned } = this.panes[number]!;
      const back = turned.quaternion.clone().invert();
      const origin = this.camera.position.clone().applyQuaternion(back);
      const ray = ahead.unproject(this.camera).applyQuaternion(back).sub(origin).normalize();
      const found = pick(bentPlaces(content), content.faces, origin.toArray(), ray.toArray());
      if (found >= 0) call(found, number);
    }
  }

  private turnByKey(event: KeyboardEvent): void {
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.12], ArrowDown: [0, 0.12],
    };
    const turn = turns[event.key];
    if (turn) {
      const offset = this.camera.position.clone();
      const polar = Math.acos(offset.y / offset.length());
      offset.applyAxisAngle(new Vector3(0, 1, 0), turn[0]);
      if (polar + turn[1] > 0.05 && polar + turn[1] < Math.PI - 0.05) {
        offset.applyAxisAngle(new Vector3(offset.z, 0, -offset.x).normalize(), turn[1]);
      }
      this.camera.position.copy(offset);
    } else if (event.key === "+" || event.key === "-") {
      this.camera.position.multiplyScalar(event.key === "+" ? 0.9 : 1.1);
    } else return;
    event.preventDefault();
    this.controls.update();
    this.draw();
  }
}

function bentPlaces({ positions, form, bend = 0 }: Content): Float32Array {
  if (!form || bend === 0) return positions;
  if (bend === 1) return form;
  return positions.map((value, i) => value + bend * (form[i]! - value));
}

/** A form may be a mirror image: its normals then point inwards, and would vanish halfway between. */
function faceAlike(from: Float32Array, to: Float32Array): void {
  let agreement = 0;
  for (let i = 0; i < from.length; i++) agreement += from[i]! * to[i]!;
  if (agreement < 0) for (let i = 0; i < to.length; i++) to[i] = -to[i]!;
}

function gradient(map: Map): DataTexture {
  const texture = new DataTexture(map.bytes, map.bytes.length / 4, 1, RGBAFormat);
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

const SIDES = 8;

function tubeAlong(line: Point[], thick: number): BufferGeometry {
  const positions: number[] = [];
  const faces: number[] = [];
  let across = new Vector3(1, 0, 0);
  line.forEach((point, number) => {
    const before = new Vector3(...line[Math.max(0, number - 1)]!);
    const direction = new Vector3(...line[Math.min(line.length - 1, number + 1)]!).sub(before).normalize();
    across = across.clone().addScaledVector(direction, -across.dot(direction));
    if (across.length() < 1e-3) across = new Vector3(direction.y, direction.z, direction.x).cross(direction);
    across.normalize();
    const other = direction.clone().cross(across);
    for (let side = 0; side < SIDES; side++) {
      const angle = (2 * Math.PI * side) / SIDES;
      const [c, s] = [Math.cos(angle) * thick, Math.sin(angle) * thick];
      positions.push(
        point[0] + c * across.x + s * other.x, point[1] + c * across.y + s * other.y, point[2] + c * across.z + s * other.z,
      );
      if (number) {
        const now = number * SIDES;
        const [a, b] = [now + side, now + ((side + 1) % SIDES)];
        faces.push(a - SIDES, b, a, a - SIDES, b - SIDES, b);
      }
    }
  });
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
  geometry.setIndex(faces);
  return geometry;
}
