# One image for every process of EIA-SEC; the process is the command: docker run eia-sec rollout --connect ...
#
#   docker build -t eia-sec .                                        # torch as the package index has it: CUDA on x86-64
#   docker build -t eia-sec --build-arg VARIANT=cpu --build-arg TORCH_INDEX=URL .
#
# VARIANT      cuda or cpu. cuda asks the NVIDIA container runtime for the accelerators; the libraries are torch's own.
#              cpu fails unless the torch that came is one without CUDA.
# TORCH_INDEX  an index of torch's wheels, looked into beside the usual one; cpu needs the one of CPU-only wheels
# PYTHON       version of the base image
# PIP_ARGS     added to every pip install
ARG VARIANT=cuda
ARG PYTHON=3.11

FROM python:${PYTHON}-slim-bookworm AS base
ARG VARIANT
ARG TORCH_INDEX=""
ARG PIP_ARGS=""
ENV PYTHONUNBUFFERED=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    NUMBA_CACHE_DIR=/var/cache/eia-sec
RUN groupadd --gid 10001 eia-sec \
    && useradd --uid 10001 --gid 10001 --create-home --shell /usr/sbin/nologin eia-sec \
    && install -d -m 1777 /var/cache/eia-sec \
    && install -d -o eia-sec -g eia-sec -m 0755 /data
# Everybody may enter /data, because Compose runs the processes as the user who owns the mounted folders.
WORKDIR /src
# The largest packages first, in a layer of their own that a change of the source leaves as it is.
COPY constraints.txt ./
# hadolint ignore=SC2086
RUN if [ "${VARIANT}" = cpu ] && [ -z "${TORCH_INDEX}" ]; then \
        echo "VARIANT=cpu needs --build-arg TORCH_INDEX=URL, an index of CPU-only wheels of torch." >&2; exit 2; \
    fi \
    && pip install -c constraints.txt ${PIP_ARGS} ${TORCH_INDEX:+--extra-index-url "${TORCH_INDEX}"} torch numba scipy \
    && if [ "${VARIANT}" = cpu ]; then \
        python -c "import sys, torch; sys.exit('TORCH_INDEX gave a torch with CUDA.' if torch.version.cuda else 0)"; \
    fi
COPY pyproject.toml README.md LICENSE ./
COPY src src
COPY common common
COPY rollout rollout
COPY learner learner
COPY elite elite
COPY deploy deploy
# hadolint ignore=SC2086
RUN pip install -c constraints.txt ${PIP_ARGS} ".[export]"
WORKDIR /data
# The simulator is compiled once, into a cache that any account may add to: other processors compile for themselves.
RUN NUMBA_NUM_THREADS=1 python -c "from eia_sec.common.config import FarmConfig; from eia_sec.rollout.sim.batch import FarmBatch; \
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
