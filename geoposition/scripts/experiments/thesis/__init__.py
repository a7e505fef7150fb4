"""T chapter 5: from star sensor, gyro and GPS to the accuracy of stereo points.

`numerical` repeats the chain by Monte Carlo, `imaged` runs it once through files and images,
`claims` checks single statements of both seed documents.
"""
