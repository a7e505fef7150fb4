"""Many runs at once, and the bound that no estimator beats."""
