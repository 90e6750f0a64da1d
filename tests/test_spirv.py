"""What a shader may declare, how it may branch, and what its instructions take: nothing that spirv-val refuses, and nothing that a few
words make a driver choke on. Modules are written in SPIR-V's assembly; what the compiler writes is tested wherever bundles are read."""

import random
import subprocess

import make_vectors
import pytest
from fuzz_bundle import mutate_instructions

from dressi_edge.cache import bundle, spirv_module
from dressi_edge.cache.errors import BundleError
from dressi_edge.cache.spirv_body import MAX_CALLS, MAX_WORK
from dressi_edge.cache.spirv_flow import MAX_NESTING, Block, Dominators, Flow
from dressi_edge.cache.spirv_interface import parse
from dressi_edge.cache.spirv_module import MAX_COMPONENTS, MAX_DEPTH, MAX_WEIGHT

TARGET = ("--target-env", "vulkan1.0")
HEAD = """OpCapability Shader
%ext = OpExtInstImport "GLSL.std.450"
OpMemoryModel Logical GLSL450
OpEntryPoint Fragment %main "main" %color %at
OpExecutionMode %main OriginUpperLeft
OpDecorate %color Location 0
OpDecorate %at Location 0
OpDecorate %at Flat
OpDecorate %map DescriptorSet 0
OpDecorate %map Binding 0
%void = OpTypeVoid
%action = OpTypeFunction %void
%bool = OpTypeBool
%int = OpTypeInt 32 1
%uint = OpTypeInt 32 0
%float = OpTypeFloat 32
%v2 = OpTypeVector %float 2
%v3 = OpTypeVector %float 3
%v4 = OpTypeVector %float 4
%i2 = OpTypeVector %int 2
%b2 = OpTypeVector %bool 2
%m2 = OpTypeMatrix %v2 2
%p_out = OpTypePointer Output %v4
%p_in = OpTypePointer Input %i2
%p_float = OpTypePointer Function %float
%image = OpTypeImage %float 2D 0 0 0 1 Unknown
%sampled = OpTypeSampledImage %image
%p_map = OpTypePointer UniformConstant %sampled
%color = OpVariable %p_out Output
%at = OpVariable %p_in Input
%map = OpVariable %p_map UniformConstant
%true = OpConstantTrue %bool
%i0 = OpConstant %int 0
%i3 = OpConstant %int 3
%u2 = OpConstant %uint 2
%f1 = OpConstant %float 1
%f22 = OpConstantComposite %v2 %f1 %f1
%unit = OpConstantComposite %m2 %f22 %f22
"""
MAIN = "%main = OpFunction %void None %action\n%first = OpLabel\n"


def assemble(text):
    """The words of a module, as written, sound or not."""
    done = subprocess.run(["spirv-as", *TARGET, "-o", "-", "-"], input=text.encode(), capture_output=True)
    assert not done.returncode, done.stderr.decode() + text
    return done.stdout


def valid(data):
    """Whether spirv-val takes it."""
    return not subprocess.run(["spirv-val", *TARGET, "-"], input=data, capture_output=True).returncode


def shader(declared="", body="OpReturn\n", more=""):
    """A fragment shader with more declarations, another body of main, or functions after it."""
    return assemble(HEAD + declared + MAIN + body + "OpFunctionEnd\n" + more)


def refused(data, told):
    with pytest.raises(BundleError) as error:
        parse(data, "shaders[7]")
    assert str(error.value).startswith("shaders[7]: ") and told in str(error.value) and str(error.value).isprintable()


def test_the_frame_of_these_tests_is_sound():
    data = shader()
    assert valid(data) and parse(data).outputs == {0: ("float", 4)} and parse(data).inputs == {0: ("int", 2)}


# ---- what may be declared: (declarations, what is told)

DECLARED = {
    "byte": ("%x = OpTypeInt 8 1", "integers of 8 bits"),
    "long": ("%x = OpTypeInt 64 1", "integers of 64 bits"),
    "half": ("%x = OpTypeFloat 16", "floats of 16 bits"),
    "double": ("%x = OpTypeFloat 64", "floats of 64 bits"),
    "type twice": ("%x = OpTypeFloat 32", "a type that there is already"),
    "huge vector": ("%x = OpTypeVector %float 1000000000", "a vector of 1000000000 of float; 2 to 4 scalars"),
    "vector of one": ("%x = OpTypeVector %int 1", "a vector of 1 of int"),
    "vector of vectors": ("%x = OpTypeVector %v2 2", "a vector of 2 of vector"),
    "vector of images": ("%x = OpTypeVector %image 2", "a vector of 2 of image"),
    "huge matrix": ("%x = OpTypeMatrix %v2 4294967295", "a matrix of 4294967295 columns"),
    "matrix of integers": ("%x = OpTypeMatrix %i2 2", "a matrix of 2 columns of vector"),
    "matrix of scalars": ("%x = OpTypeMatrix %float 2", "a matrix of 2 columns of float"),
    "array of none": ("%n = OpConstant %int 0\n%x = OpTypeArray %float %n", "is no constant integer above 0"),
    "negative array": ("%n = OpConstant %int -1\n%x = OpTypeArray %float %n", "is no constant integer above 0"),
    "array of float length": ("%x = OpTypeArray %float %f1", "is no constant integer above 0"),
    "array of a type's length": ("%x = OpTypeArray %float %int", "is no constant integer above 0"),
    "array of void": ("%x = OpTypeArray %void %i3", "holds no numbers"),
    "array of images": ("%x = OpTypeArray %image %i3", "holds no numbers"),
    "structure of functions": ("%x = OpTypeStruct %action", "holds no numbers"),
    "structure of pointers": ("%x = OpTypeStruct %p_float", "holds no numbers"),
    "structure of itself": ("%x = OpTypeStruct %float %x", "is no type defined before"),
    "pointer to void": ("%x = OpTypePointer Private %void", "a pointer of storage class 6 to void"),
    "pointer to pointer": ("%x = OpTypePointer Private %p_float", "a pointer of storage class 6 to pointer"),
    "pointer to a buffer": ("%x = OpTypePointer Uniform %float", "a pointer to storage class 2"),
    "image in private": ("%x = OpTypePointer Private %image", "a pointer of storage class 6 to image"),
    "number as a descriptor": ("%x = OpTypePointer UniformConstant %float", "a pointer of storage class 0 to float"),
    "function of functions": ("%x = OpTypeFunction %void %action", "a function that takes or returns function"),
    "function of void": ("%x = OpTypeFunction %void %void", "a function that takes void"),
    "subpass without its capability": ("%x = OpTypeImage %float SubpassData 0 0 0 2 Unknown", "without capability 40"),
    "truth of float": ("%x = OpConstantTrue %float", "a truth value of type float"),
    "number of bool": ("%x = OpConstantNull %bool\n%y = OpConstantComposite %b2 %x %x %x", "a constant of 3 parts; its type has 2"),
    "parts of other types": ("%x = OpConstantComposite %v2 %f1 %i0", "is no constant of the type of the part"),
    "parts that are types": ("%x = OpConstantComposite %v2 %float %float", "is no constant of the type of the part"),
    "parts of a scalar": ("%x = OpConstantComposite %float %f1", "a constant of 1 parts; its type has 0"),
    "null image": ("%x = OpConstantNull %image", "holds no numbers"),
    "undefined void": ("%x = OpUndef %void", "holds no numbers"),
    "variable of another class": ("%p = OpTypePointer Private %float\n%x = OpVariable %p Output", "no pointer to its storage class"),
    "variable in function": ("%x = OpVariable %p_float Function", "a variable of storage class 7"),
    "begins with another type": ("%p = OpTypePointer Private %float\n%x = OpVariable %p Private %i0", "begins with what is no constant"),
    "begins with a variable": ("%p = OpTypePointer Private %float\n%y = OpVariable %p Private\n%x = OpVariable %p Private %y",
                               "begins with what is no constant"),
}
# What spirv-val takes, and drivers do not: numbers that a few words make.
TOO_MUCH = {
    "huge private array": ("%n = OpConstant %int 67108864\n%x = OpTypeArray %float %n", f"numbers; at most {MAX_COMPONENTS} are allowed"),
    "arrays of arrays": ("%n = OpConstant %int 1000\n%x = OpTypeArray %v4 %n\n%y = OpTypeArray %x %n", "a type of 4000000 numbers"),
    "deep": ("%t0 = OpTypeStruct %float\n" + "\n".join(f"%t{k + 1} = OpTypeStruct %t{k}" for k in range(20)),
             f"nested {MAX_DEPTH + 1} deep; at most {MAX_DEPTH}"),
    "many private arrays": ("%n = OpConstant %int 16384\n%x = OpTypeArray %float %n\n%p = OpTypePointer Private %x\n"
                            + "\n".join(f"%w{k} = OpVariable %p Private" for k in range(5)), f"more than {MAX_WEIGHT} numbers in all"),
    "many null arrays": ("%n = OpConstant %int 16384\n%x = OpTypeArray %float %n\n"
                         + "\n".join(f"%w{k} = OpConstantNull %x" for k in range(5)), f"more than {MAX_WEIGHT} numbers in all"),
    "doubling structures": ("%t0 = OpTypeStruct %float %float\n" + "\n".join(f"%t{k + 1} = OpTypeStruct %t{k} %t{k}" for k in range(14)),
                            "a type of 32768 numbers"),
}


@pytest.mark.parametrize("name", DECLARED)
def test_what_may_not_be_declared_is_refused(name):
    declared, told = DECLARED[name]
    refused(shader(declared + "\n"), told)


@pytest.mark.parametrize("name", TOO_MUCH)
def test_what_grows_beyond_its_words_is_refused(name):
    declared, told = TOO_MUCH[name]
    data = shader(declared + "\n")
    assert valid(data)
    refused(data, told)


def test_what_is_just_within_the_bounds_passes():
    arrays = (f"%n = OpConstant %int {MAX_COMPONENTS // 4}\n%x = OpTypeArray %v4 %n\n%p = OpTypePointer Private %x\n"
              + "\n".join(f"%w{k} = OpVariable %p Private" for k in range(MAX_WEIGHT // MAX_COMPONENTS - 1)) + "\n")
    deep = "%t0 = OpTypeStruct %float\n" + "".join(f"%t{k + 1} = OpTypeStruct %t{k}\n" for k in range(MAX_DEPTH - 1))
    for declared in (arrays, deep):
        data = shader(declared)
        parse(data)
        assert valid(data)


# ---- what functions may do: (body of main, what is told)

AFTER = "OpReturn\n"
BODY = {
    "branch to a type": ("OpBranch %void\n", "a branch to id"),
    "branch to a constant": ("OpBranchConditional %true %i0 %first\n", "which is no block of this function"),
    "branch to a function": ("OpBranch %main\n", "which is no block of this function"),
    "branch to the first": ("OpBranch %first\n", "it branches to the first block of the function"),
    "branch on a number": ("OpSelectionMerge %x None\nOpBranchConditional %i0 %x %y\n%y = OpLabel\nOpBranch %x\n%x = OpLabel\nOpReturn\n",
                           "a branch on what is no truth value"),
    "no merge": ("OpBranchConditional %true %x %y\n%y = OpLabel\nOpReturn\n%x = OpLabel\nOpReturn\n", "without a merge instruction"),
    "merge of a type": ("OpSelectionMerge %void None\nOpBranchConditional %true %x %x\n%x = OpLabel\nOpReturn\n", "a branch to id"),
    "merge before a return": ("OpSelectionMerge %x None\nOpReturn\n%x = OpLabel\nOpReturn\n", "a merge instruction before what"),
    "merge twice": ("OpSelectionMerge %x None\nOpSelectionMerge %x None\nOpBranchConditional %true %x %x\n%x = OpLabel\nOpReturn\n",
                    "a merge instruction that is not the last but one"),
    "loop without a merge": ("OpBranch %x\n%x = OpLabel\nOpBranch %y\n%y = OpLabel\nOpBranchConditional %true %x %z\n"
        "%z = OpLabel\nOpReturn\n",
                             "branches back to what is not the header"),
    "loop that never goes on": ("OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %y None\nOpBranch %z\n%y = OpLabel\n"
        "OpUnreachable\n%z = OpLabel\n"
                                "OpReturn\n", "leaves the function from where a loop goes on"),
    "loop that goes on twice": ("OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %y None\nOpBranch %w\n%w = OpLabel\nOpSelectionMerge %v None\n"
                                "OpBranchConditional %true %y %v\n%v = OpLabel\nOpBranch %x\n%y = OpLabel\nOpBranch %x\n%z = OpLabel\n"
                                "OpReturn\n", "branches back to what is not the header"),
    "merge is continue": ("OpBranch %x\n%x = OpLabel\nOpLoopMerge %y %y None\nOpBranch %y\n%y = OpLabel\nOpReturn\n", "its merge block is"),
    "one merge for two": ("OpSelectionMerge %z None\nOpBranchConditional %true %x %z\n%x = OpLabel\nOpSelectionMerge %z None\n"
                          "OpBranchConditional %true %y %z\n%y = OpLabel\nOpBranch %z\n%z = OpLabel\nOpReturn\n", "not structured"),
    "out of two ifs": ("OpSelectionMerge %z None\nOpBranchConditional %true %x %z\n%x = OpLabel\nOpSelectionMerge %w None\n"
                       "OpBranchConditional %true %y %w\n%y = OpLabel\nOpBranch %z\n%w = OpLabel\nOpBranch %z\n%z = OpLabel\nOpReturn\n",
                       "it leaves several constructs at once"),
    "out of a switch": ("OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %y None\nOpBranch %w\n%w = OpLabel\nOpSelectionMerge %v None\n"
                        "OpSwitch %i3 %v 1 %u\n%u = OpLabel\nOpBranch %z\n%v = OpLabel\nOpBranch %y\n%y = OpLabel\nOpBranch %x\n"
                        "%z = OpLabel\nOpReturn\n", "it leaves several constructs at once"),
    "on out of a switch": ("OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %y None\nOpBranch %w\n%w = OpLabel\nOpSelectionMerge %v None\n"
                           "OpSwitch %i3 %v 1 %u\n%u = OpLabel\nOpBranch %y\n%v = OpLabel\nOpBranch %y\n%y = OpLabel\nOpBranch %x\n"
                           "%z = OpLabel\nOpReturn\n", "it leaves a construct to where that does not end"),
    "nothing leads there": ("OpReturn\n%x = OpLabel\nOpReturn\n", "nothing leads to it"),
    "out of order": ("OpBranch %x\n%y = OpLabel\nOpReturn\n%x = OpLabel\nOpBranch %y\n", "before the block that dominates it"),
    "no label": ("OpReturn\nOpReturn\n", "is not allowed outside a block"),
    "no end": ("%x = OpIAdd %int %i0 %i0\n", "opcode 56 is not allowed"),
    "phi in the first block": ("%x = OpPhi %int %i0 %first\nOpReturn\n", "a phi that is not at the beginning"),
    "phi of a stranger": ("OpBranch %y\n%y = OpLabel\n%x = OpPhi %int %i0 %y\nOpReturn\n", "a phi whose parents are not the blocks"),
    "phi of another type": ("OpBranch %y\n%y = OpLabel\n%x = OpPhi %int %f1 %first\nOpReturn\n", "which is of another type"),
    "phi too late": ("OpBranch %y\n%y = OpLabel\n%z = OpIAdd %int %i0 %i0\n%x = OpPhi %int %i0 %first\nOpReturn\n", "a phi that is not at"),
    "late variable": ("%x = OpIAdd %int %i0 %i0\n%y = OpVariable %p_float Function\nOpReturn\n", "a variable that is not at the beginning"),
    "used before": ("%x = OpIAdd %int %y %i0\n%y = OpIAdd %int %i0 %i0\nOpReturn\n", "is no value made before"),
    "used of another way": ("OpSelectionMerge %z None\nOpBranchConditional %true %x %z\n%x = OpLabel\n"
        "%y = OpIAdd %int %i0 %i0\nOpBranch %z\n"
                            "%z = OpLabel\n%w = OpIAdd %int %y %i0\nOpReturn\n", "need not run before it"),
    "a type as a value": ("%x = OpIAdd %int %int %i0\nOpReturn\n", "is no value made before"),
    "a label as a value": ("%x = OpIAdd %int %first %i0\nOpReturn\n", "is no value made before"),
    "a value as a type": ("%x = OpIAdd %i0 %i0 %i0\nOpReturn\n", "is no type defined before"),
    "floats added as integers": ("%x = OpIAdd %float %f1 %f1\nOpReturn\n", "letters iu are allowed"),
    "mixed": ("%x = OpFAdd %float %f1 %i0\nOpReturn\n", "do not go with the result's"),
    "sizes mixed": ("%x = OpFAdd %v2 %f1 %f1\nOpReturn\n", "do not go with the result's"),
    "shuffle beyond": ("%x = OpVectorShuffle %v2 %f22 %f22 0 4\nOpReturn\n", "or of scalars that they have not"),
    "extract beyond": ("%x = OpCompositeExtract %float %f22 2\nOpReturn\n", "part 2 of vector with 2"),
    "extract of a scalar": ("%x = OpCompositeExtract %float %f1 0\nOpReturn\n", "part 0 of float with 0"),
    "construct too little": ("%x = OpCompositeConstruct %v3 %f22\nOpReturn\n", "a composite of what its type has not"),
    "index beyond": ("%p = OpAccessChain %p_float %color %i3\nOpReturn\n", "or of another storage class"),
    "constant index beyond": ("%y = OpAccessChain %p_float %at %i3\nOpReturn\n", "part 3 of vector with 2"),
    "store into an input": ("%x = OpLoad %i2 %at\nOpStore %at %x\nOpReturn\n", "where nothing may be stored"),
    "store of another type": ("OpStore %color %f22\nOpReturn\n", "of another type"),
    "load of another type": ("%x = OpLoad %v3 %color\nOpReturn\n", "a load of another type"),
    "load of a value": ("%x = OpLoad %float %f1\nOpReturn\n", "is no pointer"),
    "return of a value": ("OpReturnValue %i0\n", "a return of another type"),
    "sample of integers": ("%s = OpLoad %sampled %map\n%c = OpLoad %i2 %at\n%x = OpImageSampleImplicitLod %v4 %s %c\nOpReturn\n",
                           "is no place in an image"),
    "sample to three": ("%s = OpLoad %sampled %map\n%x = OpImageSampleImplicitLod %v3 %s %f22\nOpReturn\n", "four of its numbers"),
    "fetch of a sampler": ("%s = OpLoad %sampled %map\n%c = OpLoad %i2 %at\n%x = OpImageFetch %v4 %s %c\nOpReturn\n", "is no image"),
    "query without capability": ("%s = OpLoad %sampled %map\n%g = OpImage %image %s\n%x = OpImageQuerySizeLod %i2 %g %i0\nOpReturn\n",
                                 "a query without capability 50"),
    "modf without structure": ("%x = OpExtInst %float %ext ModfStruct %f1\nOpReturn\n", "do not go with the result's"),
    "sine of an integer": ("%x = OpExtInst %float %ext Sin %i0\nOpReturn\n", "do not go with the result's"),
    "determinant of no matrix": ("%x = OpExtInst %float %ext Determinant %f1\nOpReturn\n", "do not go with the result's"),
    "calls itself": ("%x = OpFunctionCall %void %main\nOpReturn\n", "or of the entry point"),
    "calls a type": ("%x = OpFunctionCall %void %action\nOpReturn\n", "calls a function that is not there"),
}


BEYOND = {"nothing leads there", "constant index beyond", "out of a switch", "on out of a switch"}  # more than spirv-val asks


@pytest.mark.parametrize("name", BODY)
def test_what_a_function_may_not_do_is_refused(name):
    body, told = BODY[name]
    data = shader("", body)
    refused(data, told)
    assert not valid(data) or name in BEYOND


SOUND = {
    "loop": "OpBranch %x\n%x = OpLabel\n%k = OpPhi %int %i0 %first %n %y\nOpLoopMerge %z %y None\nOpBranch %w\n%w = OpLabel\n"
            "%c = OpSLessThan %bool %k %i3\nOpBranchConditional %c %v %z\n%v = OpLabel\nOpSelectionMerge %u None\n"
            "OpBranchConditional %c %t %u\n%t = OpLabel\nOpBranch %y\n%u = OpLabel\nOpSelectionMerge %q None\n"
            "OpBranchConditional %c %p %q\n"
            "%p = OpLabel\nOpBranch %z\n%q = OpLabel\nOpBranch %y\n%y = OpLabel\n%n = OpIAdd %int %k %i3\nOpBranch %x\n"
            "%z = OpLabel\nOpReturn\n",
    "loop of one block": "OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %x None\nOpBranchConditional %true %x %z\n%z = OpLabel\nOpReturn\n",
    "do while": "OpBranch %x\n%x = OpLabel\nOpLoopMerge %z %y None\nOpBranch %y\n%y = OpLabel\n"
        "OpBranchConditional %true %x %z\n%z = OpLabel\n"
                "OpReturn\n",
    "switch": "OpSelectionMerge %z None\nOpSwitch %i3 %x 1 %y 2 %z\n%x = OpLabel\nOpSelectionMerge %w None\n"
        "OpBranchConditional %true %v %w\n"
              "%v = OpLabel\nOpBranch %z\n%w = OpLabel\nOpBranch %z\n%y = OpLabel\nOpKill\n%z = OpLabel\nOpReturn\n",
    "all ways return": "OpSelectionMerge %z None\nOpBranchConditional %true %x %y\n%x = OpLabel\nOpReturn\n%y = OpLabel\n"
        "OpKill\n%z = OpLabel\n"
                       "OpUnreachable\n",
    "matrices": "%a = OpMatrixTimesVector %v2 %unit %f22\n%b = OpVectorTimesMatrix %v2 %a %unit\n%c = OpOuterProduct %m2 %a %b\n"
                "%d = OpMatrixTimesMatrix %m2 %c %unit\n%e = OpTranspose %m2 %d\n%f = OpMatrixTimesScalar %m2 %e %f1\n"
                "%g = OpExtInst %float %ext Determinant %f\n%h = OpExtInst %m2 %ext MatrixInverse %f\nOpReturn\n",
    "numbers": "%a = OpConvertFToS %int %f1\n%b = OpConvertSToF %float %a\n%c = OpBitcast %uint %b\n%d = OpShiftLeftLogical %uint %c %i3\n"
               "%e = OpBitFieldUExtract %uint %d %i0 %i3\n%f = OpUDiv %uint %e %u2\n%g = OpIEqual %bool %f %u2\n"
               "%h = OpSelect %float %g %b %f1\n%i = OpExtInst %float %ext FClamp %h %f1 %h\n%j = OpExtInst %uint %ext PackHalf2x16 %f22\n"
               "%k = OpExtInst %v2 %ext UnpackHalf2x16 %j\n%l = OpExtInst %float %ext Length %k\n%m = OpIsNan %bool %l\n"
               "%n = OpExtInst %v2 %ext Refract %k %k %l\n%o = OpDPdx %v2 %n\nOpReturn\n",
    "composites": "%a = OpCompositeConstruct %v4 %f22 %f1 %f1\n%b = OpVectorShuffle %v3 %a %f22 0 5 4294967295\n"
                  "%c = OpCompositeInsert %v3 %f1 %b 2\n%d = OpCompositeExtract %float %unit 1 0\n"
                  "%e = OpCopyObject %v3 %c\n%f = OpUndef %v4\n"
                  "OpStore %color %f\nOpReturn\n",
    "images": "%s = OpLoad %sampled %map\n%a = OpImageSampleImplicitLod %v4 %s %f22\n%b = OpImageSampleExplicitLod %v4 %s %f22 Lod %f1\n"
              "%c = OpImageSampleExplicitLod %v4 %s %f22 Grad %f22 %f22\n%g = OpImage %image %s\n%p = OpLoad %i2 %at\n"
              "%d = OpImageFetch %v4 %g %p Lod %i0\n%e = OpImageGather %v4 %s %f22 %i0\nOpReturn\n",
}


@pytest.mark.parametrize("name", SOUND)
def test_what_is_sound_passes(name):
    data = shader("", SOUND[name])
    assert valid(data)
    parse(data)


# ---- what functions are put into each other

def chain(calls, count, body=""):
    """`count` functions, each of which calls the next so often."""
    out = []
    for k in range(count):
        inner = "".join(f"%r{k}_{j} = OpFunctionCall %void %fun{k + 1}\n" for j in range(calls)) if k + 1 < count else ""
        out.append(f"%fun{k} = OpFunction %void None %action\n%l{k} = OpLabel\n{body.format(k)}{inner}OpReturn\nOpFunctionEnd\n")
    return "".join(out)


CALL = "%r = OpFunctionCall %void %fun0\nOpReturn\n"


def test_calls_that_double_are_refused_and_those_that_do_not_are_not():
    data = shader("", CALL, chain(2, 30))
    assert valid(data)
    refused(data, f"put into each other, are {MAX_WORK}"[:24])
    parse(shader("", CALL, chain(2, 12)))
    refused(shader("", CALL, chain(1, MAX_CALLS)), "deep;")
    parse(shader("", CALL, chain(1, MAX_CALLS - 1)))


def test_local_arrays_count_for_every_call():
    declared = "%n = OpConstant %int 1024\n%x = OpTypeArray %float %n\n%p = OpTypePointer Function %x\n"
    inner = "%w{} = OpVariable %p Function\n"
    parse(shader(declared, CALL, chain(2, 6, inner)))
    refused(shader(declared, CALL, chain(2, 12, inner)), "put into each other")


def test_functions_that_call_each_other_are_refused():
    ring = ("%fun0 = OpFunction %void None %action\n%l0 = OpLabel\n%a = OpFunctionCall %void %fun1\nOpReturn\nOpFunctionEnd\n"
            "%fun1 = OpFunction %void None %action\n%l1 = OpLabel\n%b = OpFunctionCall %void %fun0\nOpReturn\nOpFunctionEnd\n")
    data = shader("", CALL, ring)
    assert not valid(data)
    refused(data, "calls itself")


@pytest.mark.parametrize("call, told", [
    ("%r = OpFunctionCall %float %half %i0\n", "that does not go with its type"), ("%r = OpFunctionCall %float %half\n"
    "", "does not go with"),
    ("%r = OpFunctionCall %int %half %f1\n", "does not go with its type"), ("%r = OpFunctionCall %float %half %f1\n", None)])
def test_a_call_goes_with_what_it_calls(call, told):
    declared = "%of = OpTypeFunction %float %float\n"
    half = "%half = OpFunction %float None %of\n%x = OpFunctionParameter %float\n%in = OpLabel\nOpReturnValue %x\nOpFunctionEnd\n"
    data = shader(declared, call + "OpReturn\n", half)
    assert valid(data) is (told is None)
    if told:
        refused(data, told)
    else:
        parse(data)
    refused(shader(declared, "OpReturn\n", half.replace("%x = OpFunctionParameter %float\n", "").replace("%x", "%f1")), "lacks parameters")
    refused(shader(declared, "OpReturn\n", half.replace("Value %x", "")), "a return of another type")


# ---- interfaces

@pytest.mark.parametrize("change, told", [
    (("OpDecorate %map Binding 0", "OpDecorate %map Binding 0\nOpDecorate %map Location 3"), "have not"),
    (("OpDecorate %at Flat\n", ""), "integers need Flat"), (('"main" %color %at', '"main" %color'), None),
    (('"main" %color %at', '"main" %color %at %map'), "which is no input or output"),
    (('"main" %color %at', '"main" %color %at %at'), "names a variable twice"),
    (("OpDecorate %at Flat", "OpDecorate %at Flat\nOpDecorate %color Flat"), "nothing is interpolated there"),
    (("OpDecorate %at Flat", "OpDecorate %at Flat\nOpDecorate %int Flat"), "of what it does not go with"),
    (("OpDecorate %at Flat", "OpDecorate %at Flat\nOpDecorate %v2 Block"), "of what it does not go with"),
    (("OpDecorate %at Flat", "OpDecorate %at Flat\nOpDecorate %at Patch"), "decoration 15 is not allowed"),
    (("OpExecutionMode %main OriginUpperLeft", "OpExecutionMode %main OriginUpperLeft\nOpExecutionMode %main OriginUpperLeft"), "twice"),
    (("OpDecorate %color Location 0", "OpDecorate %color BuiltIn FragDepth"), "not of this type"),
    (("OpDecorate %at Location 0", "OpDecorate %at BuiltIn VertexIndex"), "which this stage has not"),
    (("OpMemoryModel Logical GLSL450\n", ""), "lacks its memory model"),
    (("OpDecorate %color Location 0", "OpName %color \"c\"\nOpDecorate %color Location 0"), None),
    (("OpDecorate %at Flat", "OpDecorate %at Flat\nOpName %color \"c\""), "opcode 5 comes too late")])
def test_interfaces_and_annotations(change, told):
    before, after = change
    assert HEAD.count(before) == 1
    data = assemble(HEAD.replace(before, after) + MAIN + "OpReturn\nOpFunctionEnd\n")
    if told:
        refused(data, told)
    else:
        assert valid(data)
        parse(data)


# ---- compute: (before, after, what is told); where spirv-val asks no more, it takes it

COMPUTE = """OpCapability Shader
OpMemoryModel Logical GLSL450
OpEntryPoint GLCompute %main "main" %id
OpExecutionMode %main LocalSize 8 4 2
OpDecorate %id BuiltIn GlobalInvocationId
OpDecorate %size BuiltIn WorkgroupSize
OpDecorate %picture DescriptorSet 0
OpDecorate %picture Binding 1
OpDecorate %picture NonReadable
OpDecorate %bins DescriptorSet 0
OpDecorate %bins Binding 2
OpDecorate %map DescriptorSet 0
OpDecorate %map Binding 0
%void = OpTypeVoid
%action = OpTypeFunction %void
%int = OpTypeInt 32 1
%uint = OpTypeInt 32 0
%float = OpTypeFloat 32
%v4 = OpTypeVector %float 4
%i2 = OpTypeVector %int 2
%u2 = OpTypeVector %uint 2
%u3 = OpTypeVector %uint 3
%v3 = OpTypeVector %float 3
%p_id = OpTypePointer Input %u3
%id = OpVariable %p_id Input
%stored = OpTypeImage %float 2D 0 0 0 2 Rgba32f
%p_stored = OpTypePointer UniformConstant %stored
%picture = OpVariable %p_stored UniformConstant
%counted = OpTypeImage %int 2D 0 0 0 2 R32i
%p_counted = OpTypePointer UniformConstant %counted
%bins = OpVariable %p_counted UniformConstant
%image = OpTypeImage %float 2D 0 0 0 1 Unknown
%p_image = OpTypePointer UniformConstant %image
%map = OpVariable %p_image UniformConstant
%zero = OpConstant %uint 0
%one = OpConstant %uint 1
%two = OpConstant %uint 2
%four = OpConstant %uint 4
%eight = OpConstant %uint 8
%until = OpConstant %uint 264
%i0 = OpConstant %int 0
%f1 = OpConstant %float 1
%size = OpConstantComposite %u3 %eight %four %two
%array = OpTypeArray %int %eight
%p_array = OpTypePointer Workgroup %array
%p_shared = OpTypePointer Workgroup %int
%p_texel = OpTypePointer Image %int
%parts = OpVariable %p_array Workgroup
%p_v3 = OpTypePointer Workgroup %v3
%place = OpVariable %p_v3 Workgroup
%main = OpFunction %void None %action
%first = OpLabel
%who = OpLoad %u3 %id
%at = OpVectorShuffle %u2 %who %who 0 1
%part = OpAccessChain %p_shared %parts %i0
OpStore %part %i0
%old = OpAtomicIAdd %int %part %one %zero %i0
OpControlBarrier %two %two %until
%now = OpLoad %int %part
%out = OpLoad %stored %picture
%ones = OpCompositeConstruct %v4 %f1 %f1 %f1 %f1
OpImageWrite %out %at %ones
%texel = OpImageTexelPointer %p_texel %bins %at %zero
%before = OpAtomicIAdd %int %texel %one %zero %now
OpReturn
OpFunctionEnd
"""
DIFFERENTLY = {
    "another size": ("%size = OpConstantComposite %u3 %eight %four %two", "%size = OpConstantComposite %u3 %eight %four %one", "not go"),
    "no size": ("OpExecutionMode %main LocalSize 8 4 2\n", "", "without LocalSize"),
    "size of none": ("LocalSize 8 4 2", "LocalSize 8 0 2", "workgroups of 8 x 0 x 2 invocations; 1 to 65536"),
    "size of too many": ("LocalSize 8 4 2", "LocalSize 65536 65536 65536", "workgroups of 65536 x 65536 x 65536 invocations"),
    "two sizes": ("OpExecutionMode %main LocalSize 8 4 2", "OpExecutionMode %main LocalSize 8 4 2\nOpExecutionMode %main LocalSize 8 4 2",
                  "execution mode 17 is given twice"),
    "origin": ("OpExecutionMode %main LocalSize 8 4 2", "OpExecutionMode %main LocalSize 8 4 2\nOpExecutionMode %main OriginUpperLeft",
               "of what is no fragment shader"),
    "size of something else": ("OpDecorate %size BuiltIn WorkgroupSize", "OpDecorate %eight BuiltIn WorkgroupSize", "does not go"),
    "position": ("OpDecorate %id BuiltIn GlobalInvocationId", "OpDecorate %id BuiltIn FragCoord", "built-in 15, which this stage has not"),
    "location": ("OpDecorate %id BuiltIn GlobalInvocationId", "OpDecorate %id Location 0", "of a compute shader that is no built-in"),
    "unnamed": ('"main" %id', '"main"', "used and not named by the entry point"),
    "shared is named": ('"main" %id', '"main" %id %parts', "which is no input or output"),
    "no format": ("OpTypeImage %float 2D 0 0 0 2 Rgba32f", "OpTypeImage %float 2D 0 0 0 2 Unknown", "storage of a format for it"),
    "format of a feature": ("OpTypeImage %float 2D 0 0 0 2 Rgba32f", "OpTypeImage %float 2D 0 0 0 2 Rg32f", "storage of a format for it"),
    "format of others": ("OpTypeImage %float 2D 0 0 0 2 Rgba32f", "OpTypeImage %float 2D 0 0 0 2 Rgba32i", "does not hold its numbers"),
    "three dimensions": ("OpTypeImage %int 2D 0 0 0 2 R32i", "OpTypeImage %int 3D 0 0 0 2 R32i", "storage of a format for it"),
    "sampled with a format": ("OpTypeImage %float 2D 0 0 0 1 Unknown", "OpTypeImage %float 2D 0 0 0 1 R32f", "storage of a format for it"),
    "combined": ("%image = OpTypeImage", "%both = OpTypeSampledImage %stored\n%image = OpTypeImage", "of what is no sampled image"),
    "not to be read": ("OpDecorate %map Binding 0", "OpDecorate %map Binding 0\nOpDecorate %map NonReadable", "have not"),
    "restricted": ("OpDecorate %bins Binding 2", "OpDecorate %bins Binding 2\nOpDecorate %bins Restrict", "decoration 19 is not allowed"),
    "shared and bound": ("OpDecorate %bins Binding 2", "OpDecorate %bins Binding 2\nOpDecorate %parts Binding 3", "have not"),
    "texels of floats": ("%p_texel = OpTypePointer Image %int", "%p_texel = OpTypePointer Image %float", "texels that are float"),
    "texels of another image": ("%texel = OpImageTexelPointer %p_texel %bins", "%texel = OpImageTexelPointer %p_texel %map", "one integer"),
    "texels of four": ("%texel = OpImageTexelPointer %p_texel %bins", "%texel = OpImageTexelPointer %p_texel %picture", "of one integer"),
    "sample one": ("%bins %at %zero", "%bins %at %one", "is no constant 0, as scopes, memory semantics and samples"),
    "load of a texel": ("%before = OpAtomicIAdd %int %texel %one %zero %now", "%before = OpLoad %int %texel", "is no pointer"),
    "store of a texel": ("%before = OpAtomicIAdd %int %texel %one %zero %now", "OpStore %texel %now", "is no pointer"),
    "use of an atomic": ("%now = OpLoad %int %part", "%now = OpIAdd %int %old %i0", "is no value made before"),
    "atomic of floats": ("%old = OpAtomicIAdd %int %part %one %zero %i0", "%old = OpAtomicIAdd %float %part %one %zero %f1", "a sum"),
    "atomic of a local": ("%old = OpAtomicIAdd %int %part", "%old = OpAtomicIAdd %uint %part", "a sum of what is no int"),
    "other scope": ("%old = OpAtomicIAdd %int %part %one", "%old = OpAtomicIAdd %int %part %two", "is no constant 1"),
    "other semantics": ("%old = OpAtomicIAdd %int %part %one %zero", "%old = OpAtomicIAdd %int %part %one %until", "is no constant 0"),
    "other atomics": ("%old = OpAtomicIAdd %int %part %one %zero %i0", "%old = OpAtomicISub %int %part %one %zero %i0",
                      "opcode 235 is not allowed"),
    "exchange": ("%old = OpAtomicIAdd", "%old = OpAtomicExchange", "opcode 229 is not allowed"),
    "wait for all": ("OpControlBarrier %two %two %until", "OpControlBarrier %two %one %until", "is no constant 2"),
    "wait for nothing": ("OpControlBarrier %two %two %until", "OpControlBarrier %two %two %zero", "is no constant 264"),
    "memory alone": ("OpControlBarrier %two %two %until", "OpMemoryBarrier %two %until", "opcode 225 is not allowed"),
    "write of ints": ("OpImageWrite %out %at %ones", "OpImageWrite %out %at %who", "not four of its numbers"),
    "write nowhere": ("OpImageWrite %out %at %ones", "OpImageWrite %out %who %ones", "is no place in an image"),
    "write of a sample": ("OpImageWrite %out %at %ones", "%seen = OpLoad %image %map\nOpImageWrite %seen %at %ones", "no image to write"),
    "read of a storage image": ("OpImageWrite %out %at %ones", "%seen = OpImageRead %v4 %out %at", "is no image of a subpass"),
    "fetch of a storage image": ("OpImageWrite %out %at %ones", "%seen = OpImageFetch %v4 %out %at", "is no image"),
    "begins with": ("%parts = OpVariable %p_array Workgroup", "%none = OpConstantNull %array\n%parts = OpVariable %p_array Workgroup %none",
                    "or may not"),
    "discards": ("OpReturn\n", "OpKill\n", "opcode 252 belongs to fragment shaders"),
    "takes what is shared": ("%main = OpFunction", "%takes = OpTypeFunction %void %p_shared\n%main = OpFunction", "what invocations share"),
    "in a fragment shader": ("OpEntryPoint GLCompute %main", "OpEntryPoint Fragment %main", "opcode 16 has 5 operands; 2 are needed"),
}


def test_the_frame_of_compute_shaders_is_sound():
    data = assemble(COMPUTE)
    found = parse(data)
    assert valid(data) and found.local_size == (8, 4, 2) and found.shared_bytes == 4 * 8 + 16  # three of a vector as four
    assert found.bindings == {0: (2, False, -1), 1: (3, False, 109), 2: (3, True, 99)}


@pytest.mark.parametrize("name", DIFFERENTLY)
def test_what_a_compute_shader_may_not_be_is_refused(name):
    before, after, told = DIFFERENTLY[name]
    assert COMPUTE.count(before) == 1
    refused(assemble(COMPUTE.replace(before, after)), told)


VERTEX = """OpCapability Shader
OpMemoryModel Logical GLSL450
OpEntryPoint Vertex %main "main" %out
OpDecorate %block Block
OpMemberDecorate %block 0 BuiltIn Position
OpMemberDecorate %block 1 BuiltIn PointSize
OpMemberDecorate %block 2 BuiltIn ClipDistance
%void = OpTypeVoid
%action = OpTypeFunction %void
%float = OpTypeFloat 32
%v4 = OpTypeVector %float 4
%uint = OpTypeInt 32 0
%one = OpConstant %uint 1
%two = OpConstant %uint 2
%f1 = OpConstant %float 1
%array = OpTypeArray %float %one
%block = OpTypeStruct %v4 %float %array
%p_block = OpTypePointer Output %block
%p_float = OpTypePointer Output %float
%out = OpVariable %p_block Output
%main = OpFunction %void None %action
%first = OpLabel
"""


def test_the_block_of_built_ins_is_used_by_its_members_alone():
    sound = "%x = OpAccessChain %p_float %out %one\nOpStore %x %f1\nOpReturn\nOpFunctionEnd\n"
    data = assemble(VERTEX + sound)
    found = parse(data)
    assert valid(data) and found.point_size and found.output_components == 6 and not parse(assemble(
        VERTEX + "OpReturn\nOpFunctionEnd\n")).point_size
    refused(assemble(VERTEX + sound.replace("%out %one", "%out %two %one")), "which needs a feature")
    refused(assemble(VERTEX + "%x = OpLoad %block %out\nOpReturn\nOpFunctionEnd\n"), "a load of another type")
    refused(assemble(VERTEX.replace("%block 1 BuiltIn PointSize", "%block 1 BuiltIn Layer") + sound), "is not that of the built-ins")
    refused(assemble(VERTEX.replace("OpMemberDecorate %block 1 BuiltIn PointSize\n", "") + sound), "is not that of the built-ins")


@pytest.mark.parametrize("body", ["%s = OpLoad %sampled %map\n%x = OpImageSampleImplicitLod %v4 %s %f22\n", "%x = OpDPdx %v2 %f22\n",
                                  "%s = OpLoad %sampled %map\n%x = OpImageQueryLod %v2 %s %f22\n", "OpKill\n%x = OpLabel\n"])
def test_what_needs_neighbours_belongs_to_fragment_shaders(body):
    text = HEAD.replace("Fragment %main", "Vertex %main").replace("OpExecutionMode %main OriginUpperLeft\n", "").replace(
        "OpDecorate %at Location 0", "OpDecorate %at Location 1").replace("OpDecorate %at Flat\n", "").replace(
        "OpCapability Shader", "OpCapability Shader\nOpCapability ImageQuery")
    data = assemble(text + MAIN + body + "OpReturn\nOpFunctionEnd\n")
    refused(data, "belongs to fragment shaders")
    assert not valid(data)


# ---- flow by itself

def blocks(*to):
    return [Block(0, list(x)) for x in to]


def test_dominators_of_any_graph_are_those_of_their_definition():
    """a dominates b if taking a away leaves no way to b; graphs that can be reduced, at random."""
    r = random.Random(3)
    for _ in range(300):
        n = r.randint(1, 9)
        to = [sorted({r.randrange(k + 1, n) for _ in range(r.randint(0, 2))}) if k + 1 < n else [] for k in range(n)]
        found = Dominators(to)

        def ways(without, to=to):
            seen, todo = set(), [0] if without != 0 else []
            while todo:
                at = todo.pop()
                if at not in seen and at != without:
                    seen.add(at)
                    todo += to[at]
            return seen

        for a in ways(None):
            for b in ways(None):
                assert found.over(a, b) == (a == b or b not in ways(a)), (to, a, b)
    assert Dominators([[1, 2], [2], [1]]).strange and Dominators([[1], [2], [1, 3], []]).strange is None


def test_long_chains_take_no_longer_than_they_are():
    """A loop that each of 20,000 blocks may leave: what walks up one by one would take minutes."""
    n = 20_000
    to = [[k + 1, n] for k in range(n - 1)] + [[n], []]
    found = Dominators(to)
    assert found.parent[n] == 0 and found.depth[n - 1] == n - 1 and found.over(5, n - 1) and not found.over(n - 1, n)


def test_nesting_is_bounded():
    def nest(depth):
        out, ends = "", ""
        for k in range(depth):
            out += f"OpSelectionMerge %merge{k} None\nOpBranchConditional %true %inner{k} %merge{k}\n%inner{k} = OpLabel\n"
            ends = f"OpBranch %merge{k}\n%merge{k} = OpLabel\n" + ends
        return shader("", out + ends + "OpReturn\n")

    parse(nest(MAX_NESTING))
    data = nest(MAX_NESTING + 1)
    assert valid(data)
    refused(data, f"constructs are nested deeper than {MAX_NESTING}")


def test_a_flow_without_branches_is_one_block():
    assert Flow(blocks([]), pytest.fail).reached == {0}


# ---- what passes, spirv-val passes

def test_a_module_beyond_the_size_of_any_is_refused_before_it_is_read(monkeypatch):
    monkeypatch.setattr(spirv_module, "MAX_WORDS", 10)
    refused(shader("%new = OpConstant %int 1234567\n"), "words; at most 10 are allowed")


def differ(seed, count):
    """(accepted here, and what spirv-val refused of it) of so many damaged modules."""
    r, modules = random.Random(seed), set()
    for name in make_vectors.VECTORS:
        for one in bundle.read(make_vectors.FOLDER / f"{name}.dressi").variants:
            modules |= {bytes(one.blob(k)) for k in one.description["shaders"]}
    modules, accepted, strange = sorted(x for x in modules if len(x) < 8000), 0, []
    for _ in range(count):
        data = r.choice(modules)
        changed = mutate_instructions(data, r)
        try:
            parse(changed)
        except BundleError:
            continue
        accepted += 1
        if not valid(changed):
            strange.append(changed)
    return accepted, strange


def test_what_passes_here_passes_spirv_val():
    accepted, strange = differ(0, 400)
    assert accepted > 10 and not strange


@pytest.mark.full
def test_what_passes_here_passes_spirv_val_at_length():
    assert not differ(1, 20_000)[1]
