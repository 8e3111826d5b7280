"""Text of a stage with one mesh of two quads and one material, for tests of shading."""

QUADS = """
    point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0), (2,0,0), (2,1,0)]
    int[] faceVertexCounts = [4, 4]
    int[] faceVertexIndices = [0,1,2,3, 1,4,5,2]
    texCoord2f[] primvars:st = [(0,0), (0.5,0), (0.5,1), (0,1), (1,0), (1,1)] (
        interpolation = "vertex"
    )
"""
SURFACE = """
    token outputs:surface.connect = </Looks/M/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        %s
        token outputs:surface
    }
"""
CONSTANT = SURFACE % "color3f inputs:diffuseColor = (0.5, 0.25, 0.125)"
TEXTURED = (
    SURFACE % "color3f inputs:diffuseColor.connect = </Looks/M/Tex.outputs:%s>"
    + """
    def Shader "Tex"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @%s@
        %s
        float3 outputs:rgb
        float outputs:r
        float outputs:a
    }
    def Shader "Reader"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
"""
)
ST = "float2 inputs:st.connect = </Looks/M/Reader.outputs:result>"


def textured(extra=ST, *, output="rgb", file="t.png"):
    return TEXTURED % (output, file, extra)


def stage(material, *, mesh="rel material:binding = </Looks/M>", quads=QUADS):
    return f"""def Mesh "Q" ( prepend apiSchemas = ["MaterialBindingAPI"] )
{{
    {quads}
    {mesh}
}}
def Scope "Looks"
{{
    def Material "M"
    {{
        {material}
    }}
}}
"""


def only(asset):
    (surface,) = asset.surfaces
    (material,) = surface.materials
    return surface, material
