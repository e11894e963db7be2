// Vertex shader of all passes that draw the mesh. If SHADED is defined, it also outputs the attributes that shading
// requires.

in vec3 position;
#ifdef SHADED
in vec3 normal;
in vec3 tangent;
in float handedness;
in vec2 textureUv;
in vec4 colour;
out vec3 vPosition, vNormal, vTangent;
flat out float vHandedness;
out vec2 vTextureUv;
out vec4 vColour;
#endif
uniform mat4 projection;
invariant gl_Position;

void main() {
    gl_Position = projection * vec4(position, 1.0);
#ifdef SHADED
    vPosition = position;
    vNormal = normal;
    vTangent = tangent;
    vHandedness = handedness;
    vTextureUv = textureUv;
    vColour = colour;
#endif
}
