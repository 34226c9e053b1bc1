  0 KSP Residual norm 1.732050807569e+00 
  1 KSP Residual norm 3.330669073875e-16 
