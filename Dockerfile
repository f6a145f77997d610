# One image for every process of EIA-SEC; the process is the command: docker run eia-sec rollout --connect ...
#
#   docker build -t eia-sec .                                        # torch as the package index has it: CUDA on x86-64
#   docker build -t eia-sec --build-arg VARIANT=cpu \
#                --build-arg PIP_ARGS="--extra-index-url ..." .      # torch from an index of CPU-only wheels
#
# VARIANT   cuda or cpu. cuda asks the NVIDIA container runtime for the accelerators; the libraries are torch's own.
# PYTHON    version of the base image
# PIP_ARGS  added to every pip install
ARG VARIANT=cuda
ARG PYTHON=3.11

FROM python:${PYTHON}-slim-bookworm AS base
ARG PIP_ARGS=""
ENV PYTHONUNBUFFERED=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    NUMBA_CACHE_DIR=/var/cache/eia-sec
RUN groupadd --gid 10001 eia-sec \
    && useradd --uid 10001 --gid 10001 --create-home --shell /usr/sbin/nologin eia-sec \
    && install -d -m 1777 /var/cache/eia-sec \
    && install -d -o eia-sec -g eia-sec -m 0750 /data
WORKDIR /src
# The largest packages first, in a layer of their own that a change of the source leaves as it is.
COPY constraints.txt ./
# hadolint ignore=SC2086
RUN pip install -c constraints.txt ${PIP_ARGS} torch numba scipy
COPY pyproject.toml README.md LICENSE ./
COPY common common
COPY rollout rollout
COPY learner learner
COPY elite elite
COPY deploy deploy
# hadolint ignore=SC2086
RUN pip install -c constraints.txt ${PIP_ARGS} ".[export]"
WORKDIR /data
# The simulator is compiled once, into a cache that any account may add to: other processors compile for themselves.
RUN NUMBA_NUM_THREADS=1 python -c "from common.config import FarmConfig; from rollout.farms import FarmBatch; \
FarmBatch(FarmConfig(), 1).reset(0, 0, 0)" \
    && chmod -R a+rwX /var/cache/eia-sec

FROM base AS cpu

FROM base AS cuda
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility

# hadolint ignore=DL3006
FROM ${VARIANT}
USER 10001:10001
WORKDIR /data
STOPSIGNAL SIGTERM
ENTRYPOINT ["eia-sec"]
CMD ["--help"]
