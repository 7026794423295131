"""piezo-rig: measures, models, and says what its model gets wrong and why."""

import os

__version__ = "0.1.0"

# The matrices here are small and the machine's cores are busy elsewhere: threads inside BLAS
# make a fit of a second take ten. And they change the order of its sums: the same data must give
# the same bytes whatever a user's environment says. Has to stand before numpy is imported.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"
