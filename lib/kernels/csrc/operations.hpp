// The functions that each instruction set's namespace defines; kernels.hpp says what they do.
#pragma once

#include "kernels.hpp"

#ifndef INPAINT3D_ISA
#define INPAINT3D_ISA portable
#endif

namespace inpaint3d::INPAINT3D_ISA {

void hash_forward(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads);
void hash_backward(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad,
                   int threads);
void mlp_forward(const float* x, int64_t count, Network net, float* out, int threads);
void mlp_backward(const float* x, int64_t count, Network net, const float* out_grad, float* x_grad, NetworkGrad grad,
                  int threads);
void composite_forward(Rays rays, CompositeOut out, int threads);
void composite_backward(Rays rays, const float* weights, CompositeGrad grad, float* density_grad, float* rgb_grad,
                        int threads);
void colours_forward(Logits in, float* rgb, float* diffuse_rgb, int threads);
void colours_backward(Logits in, const float* rgb_grad, const float* diffuse_rgb_grad, LogitsGrad grad, int threads);
void grid_histogram(Cells cells, const float* origins, const float* directions, int64_t rays, const float* tdist,
                    int64_t bins, float floor, float* out, int threads);
void grid_learn(float* density, int32_t side, const float* cube, const float* seen, int64_t count, float memory);
void resample(const float* sdist, const float* weights, int64_t rays, int64_t n, int64_t count, const float* jitter,
              float* out, int threads);
void unit_cube(const float* points, int64_t count, float* out, int threads);
void interlevel_forward(Histograms h, float* out, int threads);
void interlevel_backward(Histograms h, const float* out_grad, float* grad, int threads);
int64_t adam(float* param, const float* grad, float* m, float* v, int64_t count, Adam adam, int threads);
void splats_forward(Splats splats, Pinhole camera, float* rgb, int threads);
void splats_backward(Splats splats, Pinhole camera, const float* rgb, const float* rgb_grad, SplatsGrad grad, int threads);

}  // namespace inpaint3d::INPAINT3D_ISA
