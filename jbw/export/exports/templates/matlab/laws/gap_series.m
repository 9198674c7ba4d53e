function [force, m] = gap_series(p, m, from, to, v)
% Bouc-Wen's law behind a gap; remembers its force and the place in the gap.
z = m(1);
dy = to - from;
side = side_of(dy);
left = abs(dy);
if side * z < 0
    release = way_to_zero(p(3) - p(2), abs(z) / p(1));
    after = 0;
    if left <= release
        after = bouc_wen_moved(p, z, dy);
    end
    z = after * (after * z > 0);
    left = max(left - release, 0);
end
if side * z <= 0
    travel = max(p(4) - side * m(2), 0);
    if left > travel
        m(2) = side * p(4);
    else
        m(2) = m(2) + side * left;
    end
    left = max(left - travel, 0);
end
if left > 0
    z = bouc_wen_moved(p, z, side * left);
end
m(1) = z;
force = z;
end
