// Script of the exported page. It renders a mesh with baked lobes. The user can rotate the mesh and the lights.
//
// The data of the page are in two elements. "header" contains JSON. "data" contains the arrays, concatenated, deflated
// and encoded in base64. Other scripts can control the page through `window.warpdiff`, at the end of this file.

const header = JSON.parse(document.getElementById("header").textContent);
const canvas = document.getElementById("canvas");
// FRAMES_AT_REST is the number of frames that a picture at rest averages. OWN_SHARE is the standard deviation of the
// blur of one frame, relative to that of the pixel filter. The jittered positions of the frames add the rest of the
// filter.
const FRAMES_AT_REST = header.frames, OWN_SHARE = 0.2;
// Rendering time between two updates of the display while the picture is at rest [ms].
const PICTURE_MS = 14;
// Pixel filter [pixels]: parameter σ of the Gaussian, distance at which it is truncated, and standard deviation of the
// truncated Gaussian.
const FILTER = 0.5, CUT = 1.5, DEVIATION = 0.4933;
// SHADOW_SIZE is the number of texels per side of a shadow map. FRAMES_OF_SHADOW is the number of frames that share a
// shadow map if there is one light.
const SHADOW_SIZE = 4096, FRAMES_OF_SHADOW = 8;

function fail(sentence) {
    const element = document.getElementById("failed");
    element.textContent = sentence;
    element.style.display = "grid";
    throw new Error(sentence);
}

// ------------------------------------------------------------------------------------------------- unpacking of arrays

async function unpack() {
    if (typeof DecompressionStream === "undefined") {
        fail("This page needs a browser that can unpack compressed data (DecompressionStream): any of 2023 or newer.");
    }
    const text = atob(document.getElementById("data").textContent.trim());
    const packed = Uint8Array.from(text, (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const arrays = {};
    for (const { name, kind, rows, columns, begin, length } of header.arrays) {
        const part = bytes.slice(begin, begin + length);
        if (kind === "differences") arrays[name] = integers(part, rows, columns);
        else if (kind === "float32") arrays[name] = new Float32Array(part.buffer);
        else if (kind === "int8") arrays[name] = new Int8Array(part.buffer);
        else if (kind === "int16") arrays[name] = new Int16Array(part.buffer);
        else arrays[name] = part;
    }
    return arrays;
}

// Returns integers from their packed form. Columns follow one another, and each number is stored as its difference from
// the number before. The lowest bit of the stored number is the sign. The lowest bytes of all numbers precede their
// second bytes, and so on.
function integers(part, rows, columns) {
    const result = new Uint32Array(rows * columns), count = rows * columns, planes = part.length / count;
    for (let c = 0; c < columns; ++c) {
        let value = 0;
        for (let r = 0; r < rows; ++r) {
            let coded = 0;
            for (let p = planes - 1; p >= 0; --p) coded = coded * 256 + part[p * count + c * rows + r];
            value += coded & 1 ? -(coded + 1) / 2 : coded / 2;
            result[r * columns + c] = value;
        }
    }
    return result;
}

// ------------------------------------------------------------------------------------------------------------- vectors

const sub = (a, b) => a.map((x, i) => x - b[i]);
const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const length = Math.hypot(...a); return a.map((x) => x / length); };
// Returns the vector v rotated about a unit axis.
function turned(v, axis, angle) {
    const c = Math.cos(angle), s = Math.sin(angle), across = cross(axis, v), along = dot(axis, v) * (1 - c);
    return v.map((x, i) => c * x + s * across[i] + along * axis[i]);
}
// Returns the columns of a matrix from its rows, because WebGL expects matrices column by column.
const columns = (rows) => new Float32Array([0, 1, 2, 3].flatMap((c) => rows.map((row) => row[c])));
const columns3 = (rows) => new Float32Array([0, 1, 2].flatMap((c) => rows.map((row) => row[c])));

// --------------------------------------------------------------------------------------------------------------- WebGL

const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
if (!gl) {
    fail("This page needs WebGL 2, which this browser does not offer: open it in a current browser, with hardware "
        + "acceleration turned on.");
}
if (!gl.getExtension("EXT_color_buffer_float")) {
    fail("This page needs to draw into textures of floating-point numbers (EXT_color_buffer_float), which this "
        + "graphics device does not offer: open it on another one.");
}
const SUM_FORMAT = gl.getExtension("EXT_float_blend") ? gl.RGBA32F : gl.RGBA16F;

function program(vertex, fragment, constants = {}) {
    const defines = Object.entries(constants).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    const result = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, `#version 300 es\nprecision highp float;\nprecision highp int;\n${defines}${text}`);
        gl.compileShader(shader);
        gl.attachShader(result, shader);
    }
    ["position", "normal", "tangent", "handedness", "textureUv", "colour"].forEach(
        (name, at) => gl.bindAttribLocation(result, at, name));
    gl.linkProgram(result);
    if (!gl.getProgramParameter(result, gl.LINK_STATUS)) {
        const logs = gl.getAttachedShaders(result).map((shader) => gl.getShaderInfoLog(shader)).join("\n");
        fail(`The graphics driver refused a shader: ${gl.getProgramInfoLog(result)} ${logs}`);
    }
    const uniforms = {};
    for (let k = 0; k < gl.getProgramParameter(result, gl.ACTIVE_UNIFORMS); ++k) {
        const name = gl.getActiveUniform(result, k).name.replace("[0]", "");
        uniforms[name] = gl.getUniformLocation(result, name);
    }
    return { program: result, uniforms };
}

const source = (id) => document.getElementById(id).textContent;
const WHOLE = "void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }";
const NOTHING = "void main() {}";
const COPY = "uniform highp sampler2D frame; out vec4 c; void main() { c = texelFetch(frame, ivec2(gl_FragCoord), 0); }";

function texture(target, filter, define) {
    const result = gl.createTexture();
    gl.bindTexture(target, result);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) {
        gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, filter === gl.NEAREST ? gl.NEAREST : gl.LINEAR);
    define();
    return result;
}

function row(values, channels, filter, rows = 1) {
    const width = values.length / channels / rows;
    const [internal, format] = channels === 1 ? [gl.R32F, gl.RED] : [gl.RGBA16F, gl.RGBA];
    return texture(gl.TEXTURE_2D, filter, () => gl.texImage2D(
        gl.TEXTURE_2D, 0, filter === gl.NEAREST ? internal : channels === 1 ? gl.R16F : gl.RGBA16F, width, rows, 0,
        format, gl.FLOAT, values));
}

function bind(shader, name, at, target, what) {
    gl.activeTexture(gl.TEXTURE0 + at);
    gl.bindTexture(target, what);
    gl.uniform1i(shader.uniforms[name], at);
}

// ----------------------------------------------------------------------------------------------- table of baked lobes

// The coefficients of the lobes are resampled from their polar grid to a Cartesian grid with mip levels. The grid has
// one layer per colour channel and per group of four functions of w. Coefficients are divided by `lobesUnit`, so that
// they fit into half floats.
const lobes = header.lobes, groups = Math.ceil(lobes.functions / 4), layers = 3 * groups;
const SIZE = Math.min(Number(new URLSearchParams(location.search).get("size")) || lobes.size,
    gl.getParameter(gl.MAX_TEXTURE_SIZE));
const HALF_LARGEST = 1e4;
const lobesUnit = lobes.scale / HALF_LARGEST;
// A fragment may use at most MOST_FETCHES texture fetches. At each of TAPS points along a footprint, the fragment
// fetches every layer of the grid. It also fetches every group of functions of w, every wavelength of the zeroth order,
// the shadow and the base colour. TAPS is the largest number of points for which the fetches suffice. The points extend
// over DEVIATIONS standard deviations of the footprint to either side, and are STEP standard deviations apart.
const MOST_FETCHES = 64;
const TAPS = Math.min(16, Math.floor((MOST_FETCHES - 2 - groups - header.variances.length) / layers));
const DEVIATIONS = 2.4, STEP = 1.5;

function bakeGrid(arrays) {
    const { rings, rays, functions } = lobes, largest = 2 ** (8 * arrays.mantissas.BYTES_PER_ELEMENT - 1) - 1;
    const nodes = rings * rays.reduce((a, b) => a + b, 0), width = 2048, height = Math.ceil(nodes / width);
    const polar = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, polar);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, width, height, layers);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const steps = Float32Array.from({ length: 256 }, (_, e) => HALF_LARGEST * 2 ** ((e - 255) / 8) / largest);
    const values = new Float32Array(4 * width * height);
    for (let group = 0; group < groups; ++group) {
        for (let channel = 0; channel < 3; ++channel) {
            for (let node = 0; node < nodes; ++node) {
                const step = steps[arrays.exponents[channel * nodes + node]];
                for (let k = 4 * group; k < Math.min(functions, 4 * group + 4); ++k) {
                    values[4 * node + k - 4 * group] = step * arrays.mantissas[(channel * functions + k) * nodes + node];
                }
            }
            gl.texSubImage3D(
                gl.TEXTURE_2D_ARRAY, 0, 0, 0, 3 * group + channel, width, height, 1, gl.RGBA, gl.FLOAT, values);
        }
        values.fill(0);
    }
    const grid = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, grid);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, Math.floor(Math.log2(SIZE)) + 1, gl.RGBA16F, SIZE, SIZE, layers);
    const blurred = texture(
        gl.TEXTURE_2D, gl.NEAREST, () => gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, SIZE, SIZE));
    const resample = program(WHOLE, source("resample.frag"), { MOST_OCTAVES: rays.length, SIZE: SIZE.toFixed(1) });
    const sharpen = program(WHOLE, source("sharpen.frag")), target = gl.createFramebuffer(), starts = [];
    rays.reduce((start, count) => { starts.push(start); return start + rings * count; }, 0);
    gl.useProgram(resample.program);
    gl.uniform1i(resample.uniforms.ringsAnOctave, rings);
    gl.uniform1iv(resample.uniforms.raysOf, rays);
    gl.uniform1iv(resample.uniforms.startOf, starts);
    gl.uniform1f(resample.uniforms.ringOfLargest, lobes.ring_of_largest);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, SIZE, SIZE);
    gl.disable(gl.BLEND);
    gl.disable(gl.DEPTH_TEST);
    for (let layer = 0; layer < layers; ++layer) {
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, blurred, 0);
        gl.useProgram(resample.program);
        bind(resample, "polar", 0, gl.TEXTURE_2D_ARRAY, polar);
        gl.uniform1i(resample.uniforms.layer, layer);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
        gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, grid, 0, layer);
        gl.useProgram(sharpen.program);
        bind(sharpen, "frame", 1, gl.TEXTURE_2D, blurred);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(polar);
    gl.deleteTexture(blurred);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, grid);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
        gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.generateMipmap(gl.TEXTURE_2D_ARRAY);
    return grid;
}

// ------------------------------------------------------------------------------------------------------------ the mesh

// Writes the unit vector of an octahedral encoding (two integers from 0 to 65535) into an array.
function octahedral(coded, into, at) {
    const x = coded[0] / 32767.5 - 1, y = coded[1] / 32767.5 - 1, z = 1 - Math.abs(x) - Math.abs(y);
    const over = Math.max(-z, 0);
    const v = unit([x - Math.sign(x || 1) * over, y - Math.sign(y || 1) * over, z]);
    into.set(v, at);
}

function loadMesh(arrays) {
    const count = header.vertices, positions = new Float32Array(3 * count);
    for (let k = 0; k < 3 * count; ++k) positions[k] = arrays.positions[k] / 32767.5 - 1;
    const vectors = {};
    for (const name of ["normals", "tangents"]) {
        vectors[name] = new Float32Array(3 * count);
        for (let k = 0; k < count; ++k) octahedral(arrays[name].subarray(2 * k, 2 * k + 2), vectors[name], 3 * k);
    }
    const result = gl.createVertexArray();
    gl.bindVertexArray(result);
    const attribute = (at, size, type, normalized, data) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, type, normalized, 0, 0);
    };
    attribute(0, 3, gl.FLOAT, false, positions);
    attribute(1, 3, gl.FLOAT, false, vectors.normals);
    attribute(2, 3, gl.FLOAT, false, vectors.tangents);
    if (arrays.handedness) attribute(3, 1, gl.BYTE, false, arrays.handedness);
    else gl.vertexAttrib1f(3, 1);
    if (arrays.uvs) {
        const uvs = Float32Array.from(arrays.uvs, (x, k) => header.uv_low[k & 1] + x / 65535 * header.uv_span[k & 1]);
        attribute(4, 2, gl.FLOAT, false, uvs);
    }
    if (arrays.colours) {
        const colours = Float32Array.from(arrays.colours, (x, k) => k % 4 === 3 ? x : decoded(x / 255));
        attribute(5, 4, gl.FLOAT, false, colours);
    } else gl.vertexAttrib4f(5, 0, 0, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, arrays.faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { array: result, indices: arrays.faces.length, positions };
}

const decoded = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
const encoded = (c) => (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);

async function loadTexture(arrays) {
    if (!arrays.texture) {
        return texture(gl.TEXTURE_2D, gl.LINEAR, () => gl.texImage2D(
            gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(header.plain_colour)));
    }
    const options = { colorSpaceConversion: "none", premultiplyAlpha: "none", imageOrientation: "flipY" };
    const picture = await createImageBitmap(new Blob([arrays.texture], { type: "image/png" }), options);
    const result = texture(gl.TEXTURE_2D, gl.LINEAR_MIPMAP_LINEAR, () => gl.texImage2D(
        gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, picture));
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.REPEAT);
    gl.generateMipmap(gl.TEXTURE_2D);
    return result;
}

// ------------------------------------------------------------------------------------------------------ view and light

const start = () => structuredClone({ view: header.view, lights: header.lights });
let { view, lights } = start();
let exposure = header.exposure, stops = 0;
const radius = header.radius, centre = header.centre;
// Returns the coordinates of a point relative to the mesh from its world coordinates. In mesh coordinates, the mesh
// lies in the unit sphere.
const local = (point) => sub(point, centre).map((x) => x / radius);

function camera(width, height, shift) {
    const eye = local(view.eye), back = unit(sub(view.eye, view.target)), right = unit(cross(view.up, back));
    const up = cross(back, right), distance = Math.hypot(...eye);
    const near = Math.max(distance - 1.02, 1e-3 * distance), far = distance + 1.02;
    const half = Math.tan(view.fov_y_deg * Math.PI / 360), x = half * width / height;
    const rows = [right, up, back].map((axis) => [...axis, -dot(axis, eye)]);
    const depth = rows[2];
    const across = rows[0].map((r, c) => r / x + depth[c] * (shift[0] * 2 / width));
    const along = rows[1].map((r, c) => r / half + depth[c] * (shift[1] * 2 / height));
    const z = depth.map((d, c) => -(far + near) / (far - near) * d - (c === 3 ? 2 * far * near / (far - near) : 0));
    return { eye, right, up, back, half, matrix: columns([across, along, z, depth.map((d) => -d)]) };
}

// Returns the position of a point light, or the direction to a directional light, in mesh coordinates.
const placed = (light) => (light.position ? local(light.position) : unit(light.to_light));

// Returns the projection of a light's shadow map. The map covers the part of the mesh that is in the picture. The
// projection is orthographic for a directional light, and perspective from the light's position for a point light.
// `texel` is the width of a texel; for a point light, it is the width at the distance 1 from the light.
function lightCamera(light, matrix, positions) {
    const place = placed(light), away = light.position ? Math.hypot(...place) : 0;
    const back = unit(place), right = unit(cross(Math.abs(back[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], back));
    const up = cross(back, right);
    let left = Infinity, far = -Infinity, low = Infinity, high = -Infinity;
    for (let k = 0; k < positions.length; k += 3) {
        const [x, y, z] = [positions[k], positions[k + 1], positions[k + 2]];
        const w = matrix[3] * x + matrix[7] * y + matrix[11] * z + matrix[15];
        if (Math.abs(matrix[0] * x + matrix[4] * y + matrix[8] * z + matrix[12]) > 1.1 * w
            || Math.abs(matrix[1] * x + matrix[5] * y + matrix[9] * z + matrix[13]) > 1.1 * w) continue;
        const depth = away ? away - (back[0] * x + back[1] * y + back[2] * z) : 1;
        const a = (right[0] * x + right[1] * y + right[2] * z) / depth;
        const b = (up[0] * x + up[1] * y + up[2] * z) / depth;
        left = Math.min(left, a); far = Math.max(far, a); low = Math.min(low, b); high = Math.max(high, b);
    }
    if (far < left) [left, far, low, high] = [-1, 1, -1, 1];
    const size = Math.max(far - left, high - low, 1e-3) * 1.05, a = (left + far) / 2, b = (low + high) / 2;
    if (!away) {
        const rows = [
            [...right.map((r) => 2 * r / size), -2 * a / size], [...up.map((u) => 2 * u / size), -2 * b / size],
            [...back.map((r) => -r / 1.05), 0], [0, 0, 0, 1],
        ];
        return { rows, texel: size / SHADOW_SIZE };
    }
    // The light's axis is the straight line from the point light to the centre of the mesh. The last row of the
    // projection matrix yields the distance from the light along this axis. The frustum is not symmetric about the
    // axis, because the centre of the visible part of the mesh need not lie on it.
    const depth = [...back.map((r) => -r), away], [near, end] = [Math.max(away - 1.02, 1e-3), away + 1.02];
    const beside = (axis, middle) => depth.map((d, c) => 2 / size * ((c < 3 ? axis[c] : 0) - middle * d));
    const rows = [
        beside(right, a), beside(up, b),
        depth.map((d, c) => ((end + near) * d - (c === 3 ? 2 * end * near : 0)) / (end - near)), depth,
    ];
    return { rows, texel: size / SHADOW_SIZE };
}

// Returns the offset of a frame's rays from the pixel centres [pixels]. The offsets are a low-discrepancy sequence (R2,
// M. Roberts), mapped to the Gaussian distribution of the pixel filter.
function jitter(index) {
    if (FRAMES_AT_REST < 2) return [0, 0];
    const place = [0.7548776662466927, 0.5698402909980532].map((step) => (0.5 + step * (index + 1)) % 1);
    const deviation = Math.sqrt(DEVIATION ** 2 - (OWN_SHARE * DEVIATION) ** 2);
    return place.map((p) => deviation * Math.max(-CUT / FILTER, Math.min(CUT / FILTER, quantile(p))));
}

// Returns the quantile of the standard normal distribution, by Newton's method.
function quantile(p) {
    let x = 0;
    for (let k = 0; k < 30; ++k) {
        const t = 1 / (1 + 0.2316419 * Math.abs(x)), density = Math.exp(-x * x / 2) / Math.sqrt(2 * Math.PI);
        const tail = density * t * (0.31938153 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978
            + t * 1.330274429))));
        const change = ((x >= 0 ? 1 - tail : tail) - p) / Math.max(density, 1e-4);
        x -= Math.max(-0.5, Math.min(0.5, change));
        if (Math.abs(change) < 1e-7) break;
    }
    return x;
}

// ----------------------------------------------------------------------------------------------------------- rendering

let scene = null, sums = null, added = 0, changes = 0;

// Makes the render targets: a frame under one light, the depth of the frame, and the sum over all lights and frames.
function makeSums(width, height) {
    if (sums) {
        for (const texture of [sums.colour, sums.frame]) gl.deleteTexture(texture);
        for (const target of [sums.target, sums.frameTarget]) gl.deleteFramebuffer(target);
        gl.deleteRenderbuffer(sums.depth);
    }
    const drawn = [0, 1].map(() => {
        const colour = texture(
            gl.TEXTURE_2D, gl.NEAREST, () => gl.texStorage2D(gl.TEXTURE_2D, 1, SUM_FORMAT, width, height));
        const target = gl.createFramebuffer();
        gl.bindFramebuffer(gl.FRAMEBUFFER, target);
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, colour, 0);
        return [colour, target];
    });
    const depth = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT32F, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
    const [[colour, target], [frame, frameTarget]] = drawn;
    sums = { colour, target, frame, frameTarget, depth, width, height };
}

function makeShadows() {
    const map = texture(gl.TEXTURE_2D, gl.LINEAR, () => gl.texStorage2D(
        gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT32F, SHADOW_SIZE, SHADOW_SIZE));
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    const target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, map, 0);
    gl.drawBuffers([gl.NONE]);
    return { map, target };
}

// Draws the mesh. If `seen` is true, the drawn faces appear in the picture, and back faces of a closed mesh are
// omitted. Rounded vertex positions leave gaps along edges, through which back faces would show as sparkling pixels.
function drawMesh(seen = true) {
    if (header.closed && seen) gl.enable(gl.CULL_FACE);
    else gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(scene.mesh.array);
    gl.drawElements(gl.TRIANGLES, scene.mesh.indices, gl.UNSIGNED_INT, 0);
}

// Adds a frame to the sum of frames. The first frame clears the sum. During a movement, a picture is a single frame,
// which is blurred by the whole pixel filter.
function addFrame(moving) {
    const { width, height } = sums, shift = moving ? [0, 0] : jitter(added);
    const seen = camera(width, height, shift);
    gl.bindFramebuffer(gl.FRAMEBUFFER, sums.target);
    if (added === 0) gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    // The first pass draws only the depth of the frame. In the later passes, each pixel is then shaded only once per
    // light.
    gl.enable(gl.DEPTH_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, sums.frameTarget);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.depthFunc(gl.LESS);
    gl.useProgram(scene.depth.program);
    gl.uniformMatrix4fv(scene.depth.uniforms.projection, false, seen.matrix);
    gl.colorMask(false, false, false, false);
    drawMesh();
    gl.colorMask(true, true, true, true);
    lights.forEach((light, index) => {
        const shadow = scene.shadows && shadowOf(light, seen.matrix, moving ? [0.5, 0.5] : [shift[0] + 0.5, shift[1] + 0.5]);
        gl.bindFramebuffer(gl.FRAMEBUFFER, sums.frameTarget);
        gl.viewport(0, 0, width, height);
        gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
        gl.depthFunc(gl.LEQUAL);
        const { program: used, uniforms } = scene.surface;
        gl.useProgram(used);
        gl.uniformMatrix4fv(uniforms.projection, false, seen.matrix);
        gl.uniform3fv(uniforms.eye, seen.eye);
        gl.uniform4fv(uniforms.place, [...placed(light), light.position ? 1 : 0]);
        // The shader measures distances in radii of the mesh. The power of a point light is converted accordingly.
        gl.uniform1f(uniforms.power, light.position ? light.power / radius ** 2 : light.power);
        gl.uniform1f(uniforms.lightDeviation, light.deviation ?? 0);
        gl.uniform1f(uniforms.coverage, index === 0 ? 1 : 0);
        gl.uniform1f(uniforms.deviation, (moving ? 1 : OWN_SHARE) * DEVIATION);
        // At rest, frames use the finest mip level of the texture, because the average over frames already filters the
        // texture.
        gl.uniform1f(uniforms.textureBias, moving ? 0 : -16);
        bind(scene.surface, "lobes", 0, gl.TEXTURE_2D_ARRAY, scene.grid);
        bind(scene.surface, "functionsOfW", 1, gl.TEXTURE_2D, scene.functions);
        bind(scene.surface, "zerothOrder", 2, gl.TEXTURE_2D, scene.zeroth);
        bind(scene.surface, "baseColour", 3, gl.TEXTURE_2D, scene.baseColour);
        if (shadow) {
            bind(scene.surface, "shadows", 4, gl.TEXTURE_2D, scene.shadows.map);
            gl.uniformMatrix4fv(uniforms.lightProjection, false, shadow.matrix);
            gl.uniform1f(uniforms.shadowLift, 1.5 * shadow.texel);
        }
        drawMesh();
        gl.disable(gl.DEPTH_TEST);
        gl.enable(gl.BLEND);
        gl.blendFunc(gl.ONE, gl.ONE);
        gl.bindFramebuffer(gl.FRAMEBUFFER, sums.target);
        gl.useProgram(scene.sum.program);
        bind(scene.sum, "frame", 0, gl.TEXTURE_2D, sums.frame);
        gl.bindVertexArray(null);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
        gl.disable(gl.BLEND);
        gl.enable(gl.DEPTH_TEST);
    });
    ++added;
}

// Returns the shadow map of a light. With a single light, several frames share a shadow map, because drawing the map
// requires as much time as shading a frame.
function shadowOf(light, matrix, aside) {
    if (lights.length === 1 && added % FRAMES_OF_SHADOW !== 0) return scene.shadows.last;
    const { rows, texel } = lightCamera(light, matrix, scene.mesh.positions);
    // The shadow map of each frame is shifted by a part of a texel. The average over frames then hides the edges of
    // texels.
    for (const axis of [0, 1]) rows[axis] = add(rows[axis], rows[3], (aside[axis] - 0.5) * 4 / SHADOW_SIZE);
    const result = columns(rows);
    gl.bindFramebuffer(gl.FRAMEBUFFER, scene.shadows.target);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.depthFunc(gl.LESS);
    gl.useProgram(scene.depth.program);
    gl.uniformMatrix4fv(scene.depth.uniforms.projection, false, result);
    drawMesh(false);
    scene.shadows.last = { matrix: result, texel };
    return scene.shadows.last;
}

function show() {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, sums.width, sums.height);
    gl.disable(gl.DEPTH_TEST);
    gl.useProgram(scene.display.program);
    bind(scene.display, "sum", 0, gl.TEXTURE_2D, sums.colour);
    bind(scene.display, "table", 1, gl.TEXTURE_3D, scene.table);
    bind(scene.display, "mostChroma", 2, gl.TEXTURE_2D, scene.mostChroma);
    gl.uniform1f(scene.display.uniforms.frames, added);
    gl.uniform1f(scene.display.uniforms.exposure, exposure * 2 ** stops);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
}

// Returns four numbers per pixel: X, Y, Z and the coverage by the mesh, each averaged over the frames that have been
// added. The bottom row of pixels comes first.
function colours() {
    const result = new Float32Array(4 * sums.width * sums.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, sums.target);
    gl.readPixels(0, 0, sums.width, sums.height, gl.RGBA, gl.FLOAT, result);
    return result.map((x) => x / added);
}

// Returns the automatic exposure factor. It maps the mean luminance of the illuminated pixels, without the brightest
// 0.01 %, to the mean luminance that suits the display transform ACES.
function metered() {
    const xyz = colours(), luminance = [];
    for (let k = 0; k < xyz.length; k += 4) if (xyz[k + 1] > 0) luminance.push(xyz[k + 1]);
    luminance.sort((a, b) => a - b);
    const count = Math.max(luminance.length - Math.ceil(1e-4 * luminance.length), Math.min(luminance.length, 1));
    const mean = luminance.slice(0, count).reduce((a, b) => a + b, 0) / count;
    return mean > 0 ? header.mean_shown / mean : 1;
}

// --------------------------------------------------------------------------------------------------------- interaction

let lastChange = -Infinity, scheduled = false, fixedSize = null, cost = 0;

function changed() {
    fixedSize = null;
    canvas.style.width = canvas.style.height = "";
    lastChange = performance.now();
    added = 0;
    ++changes;
    schedule();
}

function schedule() {
    if (!scheduled && scene && !fixedSize) {
        scheduled = true;
        requestAnimationFrame(tick);
    }
}

function fit(scale) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * scale;
    const width = Math.max(Math.round(canvas.clientWidth * ratio), 1);
    const height = Math.max(Math.round(canvas.clientHeight * ratio), 1);
    if (!sums || sums.width !== width || sums.height !== height) {
        canvas.width = width;
        canvas.height = height;
        makeSums(width, height);
        added = 0;
    }
}

function tick() {
    scheduled = false;
    if (fixedSize) return;
    const moving = performance.now() - lastChange < 200, begin = performance.now();
    // During a movement, the resolution is halved if the last frames required more than 60 ms each.
    fit(moving && cost > 60 ? 0.5 : 1);
    if (moving) added = 0;
    else if (resting !== changes) {
        resting = changes;
        added = 0;
    }
    // At rest, as many frames are added as can be rendered between two updates of the display.
    const before = added;
    do addFrame(moving); while (!moving && added < FRAMES_AT_REST && added - before < atOnce);
    if (exposure === null) exposure = metered();
    show();
    gl.finish();
    const took = performance.now() - begin;
    if (moving) cost = Math.max(took, 0.8 * cost);
    else atOnce = Math.max(1, Math.min(16, Math.floor(PICTURE_MS * (added - before) / took)));
    showControls();
    if (moving || added < FRAMES_AT_REST) schedule();
}
let resting = -1, atOnce = 1;

function showControls() {
    const { right, up, back } = camera(1, 1, [0, 0]), light = unit(placed(lights[0]));
    const spot = document.getElementById("spot").style, behind = dot(light, back) < 0;
    spot.left = `${42 + 40 * dot(light, right)}px`;
    spot.top = `${42 - 40 * dot(light, up)}px`;
    spot.opacity = behind ? 0.35 : 1;
    document.getElementById("stopsText").textContent = `${stops >= 0 ? "+" : "−"}${Math.abs(stops).toFixed(1)} stops`;
}

function orbit(dx, dy) {
    const { right } = camera(1, 1, [0, 0]), up = unit(view.up);
    let away = turned(sub(view.eye, view.target), up, -dx);
    const tilted = turned(away, turned(right, up, -dx), -dy);
    if (Math.abs(dot(unit(tilted), up)) < 0.999) away = tilted;
    view.eye = add(view.target, away);
    changed();
}

function pan(dx, dy) {
    const { right, up, half } = camera(1, 1, [0, 0]);
    const scale = 2 * half * Math.hypot(...sub(view.eye, view.target)) / canvas.clientHeight;
    const shift = add(right.map((x) => -dx * scale * x), up, dy * scale);
    view.eye = add(view.eye, shift);
    view.target = add(view.target, shift);
    changed();
}

function zoom(factor) {
    const away = sub(view.eye, view.target), distance = Math.hypot(...away);
    const next = Math.min(Math.max(distance * factor, 0.01 * radius), 100 * radius);
    view.eye = add(view.target, away.map((x) => x * next / distance));
    changed();
}

// Rotates all lights together, so that the first one gets the direction `towards`.
function turnLights(towards) {
    const from = unit(placed(lights[0])), axis = cross(from, towards), sine = Math.hypot(...axis);
    if (sine < 1e-9) return;
    const angle = Math.atan2(sine, dot(from, towards));
    for (const light of lights) {
        const by = (v) => turned(v, axis.map((x) => x / sine), angle);
        if (light.position) light.position = add(centre, by(sub(light.position, centre)));
        else light.to_light = by(light.to_light);
    }
    changed();
}

function listen() {
    const pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const name of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointermove", (event) => {
        const before = pointers.get(event.pointerId);
        if (!before) return;
        const now = [event.clientX, event.clientY], [dx, dy] = sub(now, before);
        pointers.set(event.pointerId, now);
        if (pointers.size === 2) {
            const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
            const apart = (point) => Math.max(Math.hypot(...sub(point, other)), 1);
            zoom(apart(before) / apart(now));
            pan(dx / 2, dy / 2);
        } else if (event.buttons & 2 || event.shiftKey) pan(dx, dy);
        else orbit(dx * 0.008, dy * 0.008);
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        zoom(Math.exp(Math.max(-80, Math.min(80, event.deltaY)) * 0.002));
    }, { passive: false });
    const pad = document.getElementById("pad");
    const drag = (event) => {
        if (!event.buttons) return;
        const box = pad.getBoundingClientRect();
        let x = (event.clientX - box.left - 42) / 40, y = -(event.clientY - box.top - 42) / 40;
        const size = Math.hypot(x, y), { right, up, back } = camera(1, 1, [0, 0]);
        if (size > 1) [x, y] = [x / size, y / size];
        turnLights(add(add(right.map((r) => x * r), up, y), back, Math.sqrt(Math.max(1 - x * x - y * y, 0))));
    };
    pad.addEventListener("pointerdown", (event) => { pad.setPointerCapture(event.pointerId); drag(event); });
    pad.addEventListener("pointermove", drag);
    document.getElementById("stops").addEventListener("input", (event) => {
        stops = Number(event.target.value);
        if (added) { show(); showControls(); }
    });
    document.getElementById("meter").addEventListener("click", () => { exposure = metered(); show(); });
    document.getElementById("reset").addEventListener("click", () => { ({ view, lights } = start()); changed(); });
    window.addEventListener("resize", changed);
    canvas.addEventListener("webglcontextlost", () => fail("The graphics device was lost: reload the page."));
}

// --------------------------------------------------------------------------------------------------- start of the page

async function begin() {
    const arrays = await unpack();
    const wavelengths = header.variances.length;
    const surface = program(source("surface.vert"), source("surface.frag"), {
        SHADED: 1, SIZE: SIZE.toFixed(1), LAYERS: layers, TAPS, WAVELENGTHS: wavelengths,
        DEVIATIONS: DEVIATIONS.toFixed(2), STEP: STEP.toFixed(2), REACH: ((TAPS - 1) * STEP / 2 / DEVIATIONS).toFixed(4),
    });
    scene = {
        surface, depth: program(source("surface.vert"), NOTHING), display: program(WHOLE, source("display.frag")),
        sum: program(WHOLE, COPY),
        mesh: loadMesh(arrays), baseColour: await loadTexture(arrays), grid: bakeGrid(arrays),
        functions: row(arrays.functions, 4, gl.LINEAR, groups), zeroth: row(arrays.zeroth, 1, gl.LINEAR, wavelengths),
        mostChroma: row(arrays.most_chroma, 1, gl.NEAREST), shadows: header.shadows ? makeShadows() : null,
        table: texture(gl.TEXTURE_3D, gl.NEAREST, () => {
            const values = new Float32Array(arrays.display.length / 3 * 4), side = Math.round((values.length / 4) ** (1 / 3));
            for (let k = 0; k < arrays.display.length; ++k) values[Math.floor(k / 3) * 4 + k % 3] = arrays.display[k] / 65535;
            gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, side, side, side, 0, gl.RGBA, gl.FLOAT, values);
        }),
    };
    gl.useProgram(surface.program);
    const { uniforms } = surface;
    gl.uniform1i(uniforms.smoothNormals, header.smooth);
    gl.uniform1i(uniforms.masking, header.masking);
    gl.uniform1i(uniforms.hasShadows, header.shadows);
    gl.uniform1f(uniforms.normalReflectance, header.normal_reflectance);
    gl.uniform1i(uniforms.hasBaseColour, header.pigment_white !== null);
    gl.uniform3fv(uniforms.pigmentWhite, header.pigment_white || [0, 0, 0]);
    gl.uniformMatrix3fv(uniforms.rgbToXyz, false, columns3(header.rgb_to_xyz));
    gl.uniform1f(uniforms.unit, lobesUnit);
    gl.uniform1fv(uniforms.variances, header.variances);
    gl.uniform3fv(uniforms.weights, header.weights.flat());
    gl.uniform1i(uniforms.shadows, 4);
    gl.useProgram(scene.display.program);
    for (const [name, value] of Object.entries(header.display)) {
        const at = scene.display.uniforms[name];
        if (Array.isArray(value[0])) gl.uniformMatrix3fv(at, false, columns3(value));
        else if (Array.isArray(value)) gl[`uniform${value.length}fv`](at, value);
        else gl.uniform1f(at, value);
    }
    document.getElementById("description").textContent = header.description;
    listen();
    changed();
}

// Interface for other scripts. After `await warpdiff.ready`, call `warpdiff.render({ width, height, view, lights,
// exposure, frames, more })`; all fields are optional. The call returns { width, height, xyz }. `xyz` has the mean XYZ
// and the coverage over `frames` frames, four numbers per pixel, bottom row first. The canvas shows the picture until a
// user changes the view. With `more`, the frames are added to those of the last call.
window.warpdiff = {
    ready: begin(),
    header,
    fetches: TAPS * layers + groups + header.variances.length + 2,
    get state() { return { view, lights, exposure: exposure * 2 ** stops, frames: added, atRest: added >= FRAMES_AT_REST }; },
    render(options = {}) {
        const width = options.width || canvas.width, height = options.height || canvas.height;
        if (!options.more) {
            ({ view, lights } = { view, lights, ...options });
            if (options.exposure) [exposure, stops] = [options.exposure, 0];
            fixedSize = [width, height];
            [canvas.width, canvas.height] = fixedSize;
            canvas.style.width = `${width}px`;
            canvas.style.height = `${height}px`;
            makeSums(width, height);
            added = 0;
        }
        const frames = options.frames || FRAMES_AT_REST;
        for (let k = 0; k < frames; ++k) addFrame(frames === 1 && !options.more);
        if (exposure === null) exposure = metered();
        show();
        return { width: sums.width, height: sums.height, xyz: colours() };
    },
};
window.warpdiff.ready.catch((error) => console.error(error));
