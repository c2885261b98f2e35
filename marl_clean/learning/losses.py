"""What learning makes small, as several learners share it."""

from torch.nn import functional

DISTANCES = {
    "smooth_l1": functional.smooth_l1_loss,
    "l2": functional.mse_loss,
    "l1": functional.l1_loss,
}
