// Which instruction set computes.
#pragma once

#include <string>
#include <vector>

#include "kernels.hpp"

namespace inpaint3d {

// Names of the paths that this build has and this processor runs, best first; "portable" is always the last.
std::vector<std::string> available();

// The path in use: the best one until `use` names another.
const Kernels& active();

// False where `name` is not available.
bool use(const std::string& name);

}  // namespace inpaint3d
