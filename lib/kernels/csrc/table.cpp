// One instruction set's functions, as the table that the dispatcher picks.
#include "operations.hpp"

#define INPAINT3D_STRING(name) #name
#define INPAINT3D_NAME(name) INPAINT3D_STRING(name)

namespace inpaint3d::INPAINT3D_ISA {

const Kernels kKernels = {INPAINT3D_NAME(INPAINT3D_ISA), hash_forward, hash_backward, mlp_forward, mlp_backward,
                          composite_forward, composite_backward, colours_forward, colours_backward, grid_histogram,
                          grid_learn, resample, unit_cube, interlevel_forward, interlevel_backward, adam,
                          splats_forward, splats_backward};

}  // namespace inpaint3d::INPAINT3D_ISA
