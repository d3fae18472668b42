# lpvmpc with an OpenGL that needs no display:
#   docker build -t lpvmpc .
#   docker run --rm -v "$PWD:/work" lpvmpc track --scenario paper --render
FROM python:3.11-slim-bookworm
RUN apt-get update \
 && apt-get install -y --no-install-recommends libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri \
 && rm -rf /var/lib/apt/lists/*
ENV MUJOCO_GL=egl NUMBA_CACHE_DIR=/tmp/numba
COPY . /src
RUN pip install --no-cache-dir -c /src/constraints.txt "/src[mcap]"
WORKDIR /work
ENTRYPOINT ["lpvmpc"]
