package dressi.sample;

import android.content.Context;
import android.graphics.Canvas;
import android.graphics.Color;
import android.graphics.Paint;
import android.view.View;

/** The loss of the last steps shown, on a logarithmic scale. */
public final class CurveView extends View {
    private static final int MOST = 400;

    private final float[] losses = new float[MOST];
    private final Paint line = new Paint(Paint.ANTI_ALIAS_FLAG), words = new Paint(Paint.ANTI_ALIAS_FLAG);
    private int count;

    public CurveView(Context context) {
        super(context);
        float density = getResources().getDisplayMetrics().density;
        line.setColor(Color.rgb(0x1f, 0x77, 0xb4));
        line.setStrokeWidth(2 * density);
        words.setColor(Color.GRAY);
        words.setTextSize(12 * density);
    }

    void clear() {
        count = 0;
        invalidate();
    }

    /** Once it is full every second one is forgotten. */
    void add(float loss) {
        if (count == MOST) for (count = 0; count < MOST / 2; count++) losses[count] = losses[2 * count];
        losses[count++] = loss;
        invalidate();
    }

    @Override
    protected void onDraw(Canvas canvas) {
        float low = Float.MAX_VALUE, high = 0;
        for (int k = 0; k < count; k++) {
            low = Math.min(low, Math.max(losses[k], 1e-12f));
            high = Math.max(high, losses[k]);
        }
        if (count == 0) return;
        double top = Math.log(high + 1e-12), span = Math.max(top - Math.log(low), 1e-6);
        float before = 0, margin = words.getTextSize() * 1.5f, height = getHeight() - 2 * margin;
        for (int k = 0; k < count; k++) {
            float y = margin + (float) ((top - Math.log(Math.max(losses[k], 1e-12f))) / span) * height;
            float step = getWidth() / (float) Math.max(count - 1, 1);
            if (k > 0) canvas.drawLine((k - 1) * step, before, k * step, y, line);
            before = y;
        }
        canvas.drawText("loss " + high, 0, words.getTextSize(), words);
        canvas.drawText(Float.toString(low), 0, getHeight() - words.getTextSize() * 0.3f, words);
    }
}
