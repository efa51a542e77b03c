"""What a measurement means: predicted value, Jacobian and standard deviation."""
