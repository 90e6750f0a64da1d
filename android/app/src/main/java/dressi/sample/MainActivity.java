package dressi.sample;

import android.app.Activity;
import android.graphics.Bitmap;
import android.os.Bundle;
import android.os.Handler;
import android.os.Looper;
import android.view.Gravity;
import android.view.View;
import android.view.ViewGroup.LayoutParams;
import android.widget.AdapterView;
import android.widget.ArrayAdapter;
import android.widget.Button;
import android.widget.ImageView;
import android.widget.LinearLayout;
import android.widget.ScrollView;
import android.widget.Spinner;
import android.widget.TextView;
import android.widget.Toast;
import dressi.Device;
import dressi.DressiException;
import java.io.File;
import java.io.FileOutputStream;
import java.io.IOException;
import java.text.SimpleDateFormat;
import java.util.ArrayList;
import java.util.Date;
import java.util.List;
import java.util.Locale;

/**
 * Plays a bundle of the assets and shows how it goes: target and picture, the loss, milliseconds a step, which device and profile.
 * Leaving the screen, turning it and low memory end in {@link #onStop}: the state goes into a checkpoint, and {@link #onStart} goes on
 * from there.
 */
public final class MainActivity extends Activity implements Worker.Listener {
    private final Handler screen = new Handler(Looper.getMainLooper());
    private ImageView target, picture;
    private CurveView curve;
    private TextView status;
    private Spinner choice;
    private Worker worker;
    private boolean paused;

    @Override
    protected void onCreate(Bundle saved) {
        super.onCreate(saved);
        paused = saved != null && saved.getBoolean("paused");
        LinearLayout page = column();
        choice = new Spinner(this);
        choice.setAdapter(new ArrayAdapter<>(this, android.R.layout.simple_spinner_dropdown_item, bundles()));
        page.addView(choice);
        LinearLayout pictures = new LinearLayout(this);
        target = picture(pictures);
        picture = picture(pictures);
        page.addView(pictures);
        curve = new CurveView(this);
        page.addView(curve, new LinearLayout.LayoutParams(LayoutParams.MATCH_PARENT, dp(120)));
        LinearLayout buttons = new LinearLayout(this);
        button(buttons, "Pause / go on", new View.OnClickListener() {
            @Override
            public void onClick(View view) {
                paused = !paused;
                if (worker != null) worker.pause(paused);
            }
        });
        button(buttons, "Other pictures", new View.OnClickListener() {
            @Override
            public void onClick(View view) {
                if (worker != null) worker.otherPictures();
            }
        });
        button(buttons, "Begin again", new View.OnClickListener() {
            @Override
            public void onClick(View view) {
                restart(true);
            }
        });
        button(buttons, "Profile", new View.OnClickListener() {
            @Override
            public void onClick(View view) {
                capture();
            }
        });
        page.addView(buttons);
        status = new TextView(this);
        status.setPadding(dp(8), dp(8), dp(8), dp(8));
        page.addView(status);
        ScrollView all = new ScrollView(this);
        all.addView(page);
        setContentView(all);
        choice.setSelection(saved == null ? 0 : saved.getInt("choice"));
    }

    @Override
    protected void onStart() {
        super.onStart();
        choice.setOnItemSelectedListener(new AdapterView.OnItemSelectedListener() {
            @Override
            public void onItemSelected(AdapterView<?> parent, View view, int position, long id) {
                restart(false); // when the screen is first shown, too
            }

            @Override
            public void onNothingSelected(AdapterView<?> parent) {}
        });
    }

    @Override
    protected void onStop() {
        choice.setOnItemSelectedListener(null);
        if (worker != null) worker.finish();
        worker = null;
        super.onStop();
    }

    @Override
    protected void onSaveInstanceState(Bundle out) {
        super.onSaveInstanceState(out);
        out.putInt("choice", choice.getSelectedItemPosition());
        out.putBoolean("paused", paused);
    }

    private void restart(boolean fresh) {
        if (worker != null) worker.finish();
        worker = null;
        curve.clear();
        Object name = choice.getSelectedItem();
        if (name == null) {
            status.setText("There is no .dressi file in the assets.");
            return;
        }
        worker = new Worker(this, name.toString(), fresh, paused, this);
        worker.start();
    }

    /** Writes what this device allows to a file, for `dressi-edge compile -p`, and says where it is. */
    private void capture() {
        final File file = new File(getExternalFilesDir(null), "profile.json");
        final String date = new SimpleDateFormat("yyyy-MM-dd", Locale.ROOT).format(new Date());
        new Thread("dressi profile") {
            @Override
            public void run() {
                String said;
                try (Device device = new Device(null); FileOutputStream out = new FileOutputStream(file)) {
                    out.write(device.profile("captured", date).getBytes("UTF-8"));
                    said = "profile of " + device.name() + ": " + file;
                } catch (DressiException | IOException error) {
                    said = "profile: " + error.getMessage();
                }
                final String text = said;
                screen.post(new Runnable() {
                    @Override
                    public void run() {
                        Toast.makeText(MainActivity.this, text, Toast.LENGTH_LONG).show();
                    }
                });
            }
        }.start();
    }

    /** From the worker's thread. */
    @Override
    public void onProgress(final Worker from, final Bitmap wanted, final Bitmap now, final float loss, final String text) {
        screen.post(new Runnable() {
            @Override
            public void run() {
                if (from != worker) return; // of a bundle that was left
                if (wanted != null) target.setImageBitmap(wanted);
                if (now != null) picture.setImageBitmap(now);
                if (loss == loss) curve.add(loss);
                status.setText(text);
            }
        });
    }

    private List<String> bundles() {
        List<String> found = new ArrayList<>();
        try {
            for (String name : getAssets().list("")) if (name.endsWith(".dressi")) found.add(name);
        } catch (IOException none) {
            // then there are none to choose from
        }
        return found;
    }

    private LinearLayout column() {
        LinearLayout made = new LinearLayout(this);
        made.setOrientation(LinearLayout.VERTICAL);
        made.setGravity(Gravity.CENTER_HORIZONTAL);
        return made;
    }

    private ImageView picture(LinearLayout parent) {
        ImageView made = new ImageView(this);
        made.setAdjustViewBounds(true);
        made.setScaleType(ImageView.ScaleType.FIT_CENTER);
        parent.addView(made, new LinearLayout.LayoutParams(0, dp(180), 1));
        return made;
    }

    private void button(LinearLayout parent, String text, View.OnClickListener what) {
        Button made = new Button(this);
        made.setText(text);
        made.setOnClickListener(what);
        parent.addView(made, new LinearLayout.LayoutParams(0, LayoutParams.WRAP_CONTENT, 1));
    }

    private int dp(int size) {
        return Math.round(size * getResources().getDisplayMetrics().density);
    }
}
