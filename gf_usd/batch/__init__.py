"""Many bakes: a manifest becomes jobs, and jobs run here, on a cluster or on a farm."""
