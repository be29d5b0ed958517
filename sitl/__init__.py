"""The simulator: scene, vehicle, camera and autopilot. Not part of the flight software.

Its models share only the camera-stream format with the product. apps, bench and faults/flights join both; of the product
only the command line starts them.
"""
