#pragma once

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sensor/noise_model.h"
#include "worker/sensor/psf.h"

namespace trem {

// The sensor's PSF: from the spec, the kernel that INGEST put into the manifest, and the width that was estimated when none was given.
PsfParameters PsfParametersOf(const v1::Sensor& sensor, const v1::SensorManifest& found);

// wavelength * f_number / pixel_pitch, 0 when not all of them are given.
double OpticsQ(const v1::Sensor& sensor);

// Read and photon noise in internal grey levels. Black is grey level 0 of the source; the typical variance is that of the sortie's median
// grey. When only the photon noise is given, the manifest's estimate counts as the typical noise and the read noise is the rest.
NoiseModel NoiseModelOf(const v1::Sensor& sensor, const v1::SortieManifest& manifest);

// Reads sensor.psf_kernel_path: the text form (ParsePsfKernel), or a single-band PNG or TIFF with the metadata item samples_per_pixel.
Result<PsfKernel> ReadPsfKernel(const std::string& path);

}  // namespace trem
