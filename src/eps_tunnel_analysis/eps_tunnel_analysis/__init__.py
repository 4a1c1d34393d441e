# SPDX-License-Identifier: Apache-2.0
"""How far a simulation is from a real rig, where, and which physical effect the model lacks."""

import os

# Roll-outs take the processors; on matrices as small as ours more threads of BLAS only get in their way. Read when
# numpy is first imported.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
