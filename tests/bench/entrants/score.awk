# HILDOCK-1 from its page alone: plant and indices with the method `none`.
# Prints number, e, e_ref, peak force error, contact time error and tracking error of each case given.
function draw() { state = (16807 * state) % 2147483647; return state / 2147483647 }
function law(x, v,    f) {
    if (x <= 0) return 0
    f = track == "hunt_crossley" ? K * x * (1 + 2 * C / (K * D) * v) : K * x + C * v
    if (track == "hard_stop" && x > 0.6 * D) f += 4 * K * (x - 0.6 * D)
    return f > 0 ? f : 0
}
BEGIN {
    h = 0.0005; m = 400; v0 = 0.03; x0 = -0.00101; pi = atan2(0, -1)
    split("exact off-30 off-20 off-10 off+10 off+20 off+30 jitter drift lowpass hunt_crossley " \
          "hard_stop", tracks)
    split("1 2 4 8", fs); split("0.002 0.005 0.010 0.020", ds); split("0.02 0.05 0.2", zs)
}
{
    i = $1
    track = tracks[int(i / 48) + 1]; f = fs[int(i / 12) % 4 + 1]; d = ds[int(i / 3) % 4 + 1]
    z = zs[i % 3 + 1]
    w = 2 * pi * f; K = m * w * w; C = 2 * z * sqrt(K * m); D = v0 / w
    N = int((-x0 / v0 + 0.75 / f + 0.1) / h) + 1
    x[0] = r[0] = x0; v = vr = v0; s[-1] = peak = ref = touched = reftouched = last = deep = 0
    state = 12345 + 7919 * i
    for (n = 0; n < 20; n++) draw()
    for (k = 0; k < N; k++) {
        F = law(x[k], k ? (x[k] - x[k - 1]) / h : v0)
        R = law(r[k], vr); vr -= h * R / m; r[k + 1] = r[k] + h * vr
        if (F > peak) peak = F
        if (F > 0) touched++
        if (R > ref) ref = R
        if (R > 0) { reftouched++; last = k + 1 }
        if (r[k + 1] > deep) deep = r[k + 1]
        s[k] = s[k - 1] + (track == "lowpass" ? h / (h + 0.001) : 1) * (F - s[k - 1])
        for (noise = n = 0; n < 12; n++) noise += draw()
        noise -= 6; u = draw()
        late = d
        if (track == "drift") late *= 1 + 0.1 * k / N
        if (track == "jitter") late += (2 * u - 1) * h
        q = k - late / h; j = int(q)
        y = q < 0 ? 0 : s[j] + (q - j) * (s[j + 1] - s[j])
        v -= h * (y + 0.002 * v0 * sqrt(K * m) * noise) / m
        x[k + 1] = x[k] + h * v
    }
    for (off = k = 0; k < last; k++) off += (x[k] - r[k]) ^ 2
    printf "%d %.12g %.12g %.12g %.12g %.12g\n", i, (x[N - 40] - x[N]) / (40 * h * v0),
        (r[N - 40] - r[N]) / (40 * h * v0), peak / ref - 1, touched / reftouched - 1,
        sqrt(off / last) / deep
}
