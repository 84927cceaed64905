"""The kernels in C, and the functions of NumPy arrays that call them."""
