# syntax=docker/dockerfile:1

# The build compiles every numeric kernel, for any processor of its architecture. So no job waits for a compiler, the
# image also runs on other machines than the one that built it, and a container needs to write only its library.
FROM python:3.13-slim AS base
ENV PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/opt/unbend/kernels \
    NUMBA_CPU_NAME=generic \
    PATH=/opt/unbend/venv/bin:$PATH

FROM base AS build
# binutils has `strip`. A fixed version would disappear from Debian's mirrors with the next security update.
# hadolint ignore=DL3008
RUN apt-get update \
 && apt-get install --yes --no-install-recommends binutils \
 && python -m venv --without-pip /opt/unbend/venv
WORKDIR /src
COPY pyproject.toml README.md LICENSE hatch_build.py ./
COPY openapi ./openapi
COPY image ./image
COPY service ./service
RUN pip --python /opt/unbend/venv/bin/python install --no-cache-dir --no-compile '/src[cluster]' \
 && python image/slim.py /opt/unbend/venv
# This also compiles the modules that a server imports. The others stay source: their bytecode would be as large.
RUN unbend openapi >/dev/null \
 && python -c "from unbend.jobs.kernels import compile_kernels; compile_kernels()"

FROM base
# Everything but the library belongs to root, so that the service cannot change its own code.
RUN useradd --uid 10001 --home-dir /library --no-create-home --shell /usr/sbin/nologin unbend \
 && install --directory --owner unbend --group unbend /library
COPY --from=build /opt/unbend /opt/unbend
ENV PYTHONDONTWRITEBYTECODE=1 \
    UNBEND_LIBRARY=/library/unbend.db
USER 10001
WORKDIR /library
VOLUME /library
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/v1/livez', timeout=4)"]
ENTRYPOINT ["unbend"]
CMD ["serve", "--host", "0.0.0.0", "--port", "8000"]
