/** The board as it is seen: tiles, a line of text above them, and a dot for each fingertip. */

import { boardPose, HEIGHT_MM, WIDTH_MM } from "./contact.js";

/** Textures of the server, from left to right, each with a color. */
export const TILES = [
  { texture: "wood-oak", color: [168, 118, 66] },
  { texture: "textile-corduroy", color: [70, 96, 140] },
  { texture: "metal-knurled-rge08", color: [150, 155, 160] },
  { texture: "leather-pebbled", color: [110, 62, 44] },
  { texture: "stone-granite-flamed", color: [140, 132, 128] },
];
export const TILE_MM = WIDTH_MM / TILES.length;
/** Height of the text above the tiles and space between tiles [mm], and pixels per millimeter. */
const [TEXT_MM, GAP_MM] = [40, 1];
const SCALE = 2;

const VERTEX = `#version 300 es
uniform mat4 projection, view, board;
uniform vec3 center;
uniform vec2 size;
out vec2 place;
void main() {
  place = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = projection * view * board * vec4(center + vec3((place - 0.5) * size, 0), 1);
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D picture;
uniform bool round;
uniform vec4 color;
in vec2 place;
out vec4 drawn;
void main() {
  if (round && length(place - 0.5) > 0.5) discard;
  drawn = round ? color : texture(picture, vec2(place.x, 1.0 - place.y));
}`;

/** Draws the board with WebGL. */
export class Board {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    const canvas = document.createElement("canvas");
    canvas.width = SCALE * WIDTH_MM;
    canvas.height = SCALE * (HEIGHT_MM + TEXT_MM);
    this.picture = canvas.getContext("2d");
    this.picture.scale(SCALE, SCALE);
    this.picture.translate(0, TEXT_MM);
    this.picture.fillStyle = "white";
    this.picture.fillRect(0, 0, WIDTH_MM, HEIGHT_MM);
    TILES.forEach((_, index) => this.#paintTile(index, () => 1));
  }

  /** Write a line of text above the tiles, on a color. */
  show(text, color) {
    const { picture } = this;
    picture.fillStyle = color;
    picture.fillRect(0, -TEXT_MM, WIDTH_MM, TEXT_MM);
    picture.fillStyle = "white";
    picture.font = "20px sans-serif";
    picture.fillText(text, 10, -13, WIDTH_MM - 20);
    this.#upload();
  }

  /**
   * Draw a frame.
   *
   * @param {XRFrame} frame
   * @param {XRReferenceSpace} floor
   * @param {{x: number, y: number, z: number, touches: boolean}[]} tips Fingertips [mm].
   */
  draw(frame, floor, tips) {
    const { gl, program } = this;
    const layer = frame.session.renderState.baseLayer;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    const opaque = Number(frame.session.environmentBlendMode === "opaque"); // VR, not AR
    gl.clearColor(0.1 * opaque, 0.1 * opaque, 0.1 * opaque, opaque);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(program);
    const uniform = (name) => gl.getUniformLocation(program, name);
    gl.uniformMatrix4fv(uniform("board"), false, boardPose().matrix);
    for (const view of frame.getViewerPose(floor)?.views ?? []) {
      const { x, y, width, height } = layer.getViewport(view);
      gl.viewport(x, y, width, height);
      gl.uniformMatrix4fv(uniform("projection"), false, view.projectionMatrix);
      gl.uniformMatrix4fv(uniform("view"), false, view.transform.inverse.matrix);
      const quad = (center, size, round, color) => {
        gl.uniform3fv(uniform("center"), center.map((mm) => mm / 1000));
        gl.uniform2fv(uniform("size"), size.map((mm) => mm / 1000));
        gl.uniform1i(uniform("round"), round);
        gl.uniform4fv(uniform("color"), color);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      };
      quad([0, TEXT_MM / 2, 0], [WIDTH_MM, HEIGHT_MM + TEXT_MM], 0, [0, 0, 0, 1]);
      for (const tip of tips) { // over the board, so that a finger in it is seen
        quad([tip.x, tip.y, tip.z], [14, 14], 1, tip.touches ? [1, 0.8, 0, 1] : [1, 1, 1, 1]);
      }
    }
  }

  /** Return the section of its surface that a tile shows, for `Connection.drawTexture`. */
  section(index) {
    return {
      texture: TILES[index].texture,
      left_mm: index * TILE_MM + GAP_MM - WIDTH_MM / 2,
      bottom_mm: -HEIGHT_MM / 2,
      pixel_mm: 1 / SCALE,
      columns: SCALE * (TILE_MM - 2 * GAP_MM),
      rows: SCALE * HEIGHT_MM,
    };
  }

  /** Paint a tile with the surface that the server has drawn. */
  paintSurface(index, { pixels }) {
    this.#paintTile(index, (k) => 0.5 + pixels[k] / 255);
  }

  #paintTile(index, light) {
    const { picture } = this;
    const { texture, color } = TILES[index];
    const { columns, rows } = this.section(index);
    const tile = picture.createImageData(columns, rows);
    for (let k = 0; k < columns * rows; k++) {
      tile.data.set([...color.map((part) => part * light(k)), 255], 4 * k);
    }
    picture.putImageData(tile, SCALE * (index * TILE_MM + GAP_MM), SCALE * TEXT_MM);
    picture.fillStyle = "white";
    picture.font = "9px sans-serif";
    picture.fillText(texture, index * TILE_MM + 5, HEIGHT_MM - 6, TILE_MM - 10);
    this.#upload();
  }

  #upload() {
    const { gl, picture } = this;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture.canvas);
    gl.generateMipmap(gl.TEXTURE_2D);
  }
}
