"""The batch estimate: least squares over all nodes of a drive, with the marginal sigmas."""
